"""Setpoints for a PX4 in OFFBOARD: streamed while the vehicle is ours and heard, and never again once it is not.

PX4 goes back to OFFBOARD by itself when setpoints come again after their loss. So none is sent after a silence of the
vehicle before it has told its mode: in that time, somebody else may have taken it.

Altitudes are above the sea: PX4 1.16.1 takes those above home wrongly, by twice the height of home above the
origin of its estimator (it flew 11.9 m high for 10 m).
"""

from __future__ import annotations

import asyncio
import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Velocity
from upwash.real.mavlink.course import Abilities, Course
from upwash.real.mavlink.hearing import Message
from upwash.real.mavlink.vehicle import MavlinkVehicle
from upwash.real.mavlink.whereabouts import Whereabouts
from upwash.support.background import end, start

_PERIOD_S = 0.05
_SILENT_AFTER_S = 0.6  # its position comes ten times a second; below COM_OF_LOSS_T, which is 1 s by default
_LONGEST_STEP_S = 0.2  # of the course: a busy computer must not make it jump
_YAW_RATE_IGNORED = mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_WITHOUT_YAW = mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE | _YAW_RATE_IGNORED


class SetpointStream:
    """Has the vehicle follow a course, from `begin` to `end`."""

    def __init__(self, vehicle: MavlinkVehicle, where: Whereabouts) -> None:
        self.abilities = Abilities()
        self.course: Course | None = None
        self.heading_deg: float | None = None  # to be kept; without it PX4 has its own
        self._vehicle = vehicle
        self._where = where
        self._silence_seen_s = vehicle.now_s
        self._task: asyncio.Task[None] | None = None

    def begin(self) -> Course:
        """Streams from now on where the vehicle is, and where the course then goes."""
        self.course = self._course_from_here()
        if self._task is None:
            # Without setpoints PX4 leaves OFFBOARD, as COM_OBL_RC_ACT says, and the flight ends.
            self._task = start(self._run(), name="setpoints", failed=lambda _: self.end())
        return self.course

    def end(self) -> None:
        """Sends no more setpoints."""
        self.course = self.heading_deg = None

    async def close(self) -> None:
        """Ends it for good."""
        self.end()
        await end(self._task)

    async def _run(self) -> None:
        vehicle = self._vehicle
        sent_s = vehicle.now_s
        while vehicle.is_ours:
            passed_s = min(vehicle.now_s - sent_s, _LONGEST_STEP_S)
            sent_s = vehicle.now_s
            if self.course is not None and self._is_heard():
                self.course.advance(passed_s, vehicle=self._where.position)
                self._send(self.course)
            await asyncio.sleep(_PERIOD_S)
        self.end()  # for good: nothing makes a vehicle ours again

    def _is_heard(self) -> bool:
        """Whether it is, and has told its mode since it was last not."""
        vehicle = self._vehicle
        if vehicle.silent_s > _SILENT_AFTER_S:
            self._silence_seen_s = vehicle.now_s
            return False
        if vehicle.mode_told_s > self._silence_seen_s:
            return True
        vehicle.ask_for(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        return False

    def _send(self, course: Course) -> None:
        place, velocity = self._where.above_sea(course.position), course.setpoint_velocity
        push = course.setpoint_acceleration

        def message(system: int, component: int) -> Message:
            return mavlink.MAVLink_set_position_target_global_int_message(
                0,
                system,
                component,
                mavlink.MAV_FRAME_GLOBAL_INT,
                _WITHOUT_YAW if self.heading_deg is None else _YAW_RATE_IGNORED,
                round(place.latitude_deg * 1e7),
                round(place.longitude_deg * 1e7),
                place.altitude_m,
                velocity.north_m_s,
                velocity.east_m_s,
                -velocity.up_m_s,
                push.north_m_s,
                push.east_m_s,
                -push.up_m_s,
                math.radians(math.remainder(self.heading_deg or 0.0, 360)),
                0.0,
            )

        self._vehicle.steer("setpoint", message)

    def _course_from_here(self) -> Course:
        return Course(self._where.position, self._vehicle.telemetry.velocity or Velocity(), self.abilities)
