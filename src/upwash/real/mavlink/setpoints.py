"""Setpoints for a PX4 in OFFBOARD: the moving point of a course, streamed to the vehicle.

Setpoints are sent while the vehicle is ours and linked. PX4 goes back to OFFBOARD by itself when setpoints come
again after their loss. So after a silence of the vehicle, none is sent before it has reported its mode: a pilot may
have taken it meanwhile.

Altitudes are above the sea: PX4 1.16.1 takes those above home wrongly, by twice the height of home above the
origin of its estimator (it flew 11.9 m high for 10 m).
"""

from __future__ import annotations

import asyncio
import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position, Velocity, ground_distance_m
from upwash.core.vehicle.course import Abilities, SetpointCourse
from upwash.real.mavlink.tracker import PositionTracker
from upwash.real.mavlink.vehicle import MavlinkVehicle
from upwash.support.background import end, start

_TURNS_DEG_S = 45.0  # a setpoint that jumps makes the vehicle turn with all its might
_LOOKS_AHEAD_M = 5.0  # a shorter leg does not turn the nose, as with an ArduCopter

_PERIOD_S = 0.05
_SILENT_AFTER_S = 0.6  # its position comes ten times a second; below COM_OF_LOSS_T, which is 1 s by default
_LONGEST_STEP_S = 0.2  # of the course: a busy computer must not make it jump
_YAW_RATE_IGNORED = mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_WITHOUT_YAW = mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE | _YAW_RATE_IGNORED


class SetpointStream:
    """Sends the vehicle the setpoints of a course, from `begin` to `end`."""

    def __init__(self, vehicle: MavlinkVehicle, tracker: PositionTracker) -> None:
        self.abilities = Abilities()
        self.course: SetpointCourse | None = None
        self.heading_deg: float | None = (
            None  # where the nose turns, and stays; None: where it points already
        )
        self._nose_deg: float | None = (
            None  # as it is sent: a PX4 without a heading drifted by 35 degrees in 3 minutes
        )
        self._vehicle = vehicle
        self._tracker = tracker
        self._silence_seen_s = vehicle.now_s
        self._task: asyncio.Task[None] | None = None

    def begin(self) -> SetpointCourse:
        """Begin to send setpoints; return the new course, which starts at the vehicle's place and velocity."""
        velocity = self._vehicle.telemetry.velocity or Velocity()
        self.course = SetpointCourse(self._tracker.position, velocity, self.abilities)
        if self._nose_deg is None:
            self._nose_deg = self._vehicle.telemetry.heading_deg
        if self._task is None:
            # Without setpoints PX4 leaves OFFBOARD, as COM_OBL_RC_ACT says, and the flight ends.
            self._task = start(self._run(), name="setpoints", failed=lambda _: self.end())
        return self.course

    def end(self) -> None:
        """Stop sending setpoints; `begin` starts again."""
        self.course = self.heading_deg = self._nose_deg = None

    def look_at(self, target: Position) -> None:
        """Turn the nose to a target; where it points now, if the target is near."""
        here = self._tracker.position
        self.heading_deg = None
        if ground_distance_m(here, target) >= _LOOKS_AHEAD_M:
            east_m, north_m = target.east_m - here.east_m, target.north_m - here.north_m
            self.heading_deg = math.degrees(math.atan2(east_m, north_m)) % 360

    async def close(self) -> None:
        """Stop sending setpoints for good, and end the task."""
        self.end()
        await end(self._task)

    async def _run(self) -> None:
        vehicle = self._vehicle
        sent_s = vehicle.now_s
        while vehicle.is_ours:
            passed_s = min(vehicle.now_s - sent_s, _LONGEST_STEP_S)
            sent_s = vehicle.now_s
            if self.course is not None and self._is_linked():
                self._turn(passed_s)
                self.course.advance(passed_s, vehicle=self._tracker.present_position)
                self._send(self.course)
            await asyncio.sleep(_PERIOD_S)
        self.end()  # for good: nothing makes a vehicle ours again

    def _turn(self, passed_s: float) -> None:
        if self.heading_deg is None:
            return
        nose_deg = self.heading_deg if self._nose_deg is None else self._nose_deg
        left_deg, most_deg = math.remainder(self.heading_deg - nose_deg, 360), _TURNS_DEG_S * passed_s
        self._nose_deg = nose_deg + max(-most_deg, min(most_deg, left_deg))

    def _is_linked(self) -> bool:
        """Whether the vehicle is not silent, and has reported its mode since its last silence."""
        vehicle = self._vehicle
        if vehicle.silent_s > _SILENT_AFTER_S:
            self._silence_seen_s = vehicle.now_s
            return False
        if vehicle.mode_told_s > self._silence_seen_s:
            return True
        vehicle.ask_for(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        return False

    def _send(self, course: SetpointCourse) -> None:
        place, velocity = self._tracker.above_sea(course.position), course.setpoint_velocity
        push = course.setpoint_acceleration
        message = mavlink.MAVLink_set_position_target_global_int_message(
            0,
            *self._vehicle.ids,
            mavlink.MAV_FRAME_GLOBAL_INT,
            _WITHOUT_YAW if self._nose_deg is None else _YAW_RATE_IGNORED,
            round(place.latitude_deg * 1e7),
            round(place.longitude_deg * 1e7),
            place.altitude_m,
            *(velocity.north_m_s, velocity.east_m_s, -velocity.up_m_s),
            *(push.north_m_s, push.east_m_s, -push.up_m_s),
            math.radians(math.remainder(self._nose_deg or 0.0, 360)),
            0.0,
        )
        self._vehicle.steer("setpoint", message)
