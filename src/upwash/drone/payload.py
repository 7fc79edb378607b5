"""What the vehicle carries, as a mission uses it."""

from __future__ import annotations

import math

from upwash.core.payload import (
    DO_DIGICAM_CONTROL,
    DO_GIMBAL_MANAGER_PITCHYAW,
    MOST_PARAMETERS,
    PAYLOAD_COMMANDS,
)
from upwash.drone.mission import MissionThread
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.ports import Autopilot, Journal

_SHOOT = (0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)


class Payload:
    """Gimbal, camera trigger, servos and such: each verb returns once the vehicle has accepted it.

    Each raises AutopilotRefused where the vehicle has no such thing, AutopilotOverruled where somebody else has the
    vehicle.
    """

    def __init__(self, autopilot: Autopilot, thread: MissionThread, journal: Journal) -> None:
        self._autopilot = autopilot
        self._thread = thread
        self._journal = journal

    def point_gimbal(self, *, pitch_deg: float, yaw_deg: float = 0.0) -> None:
        """Turns the gimbal: -90 looks straight down, 0 ahead; the yaw is relative to the vehicle's nose.

        It does not wait for the gimbal. UsageError for a pitch beyond ±90 or a yaw beyond ±180 degrees.
        """
        for name, value, most in (("pitch_deg", pitch_deg, 90), ("yaw_deg", yaw_deg, 180)):
            if not abs(value) <= most:
                raise UsageError(f"point_gimbal: {name} is {value}: give degrees from -{most} to {most}")
        self.command(DO_GIMBAL_MANAGER_PITCHYAW, pitch_deg, yaw_deg, math.nan, math.nan)

    def trigger_camera(self) -> None:
        """Has the camera that is connected to the autopilot shoot; its photo does not come to the mission."""
        self.command(DO_DIGICAM_CONTROL, *_SHOOT)

    def command(self, number: int, *parameters: float) -> None:
        """Sends a MAVLink command of a payload with up to seven parameters; the others are 0.

        UsageError for a command that could move, arm or reconfigure the vehicle: docs/missions.md has those that may
        be sent.
        """
        if number not in PAYLOAD_COMMANDS:
            raise UsageError(
                f"MAVLink command {number} is not sent: only commands of payloads are, such as 183 (DO_SET_SERVO) or "
                "31010 to 31014 (of your own). Fly with drone.autopilot"
            )
        if len(parameters) > MOST_PARAMETERS:
            raise UsageError(
                f"MAVLink command {number}: {len(parameters)} parameters, and a command has at most {MOST_PARAMETERS}"
            )
        self._thread.call(self._command(number, parameters))

    async def _command(self, number: int, parameters: tuple[float, ...]) -> None:
        name = PAYLOAD_COMMANDS[number]
        await self._autopilot.command(number, name, parameters)
        self._journal.record(
            schema.PayloadCommanded(
                number=number,
                name=name,
                parameters=[each if math.isfinite(each) else None for each in parameters],
            )
        )
