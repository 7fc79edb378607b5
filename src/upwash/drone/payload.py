"""The drone's payload as a mission uses it: devices that obey MAVLink commands."""

from __future__ import annotations

import asyncio
import math

from upwash.core.vehicle.payload import (
    DO_DIGICAM_CONTROL,
    DO_GIMBAL_MANAGER_PITCHYAW,
    IMAGE_START_CAPTURE,
    MOST_PARAMETERS,
    PAYLOAD_COMMANDS,
)
from upwash.drone.mission import MissionThread
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.ports import Autopilot, Journal
from upwash.support.background import now_s

_SHOTS = (DO_DIGICAM_CONTROL, IMAGE_START_CAPTURE)
_BETWEEN_SHOTS_S = 0.5  # more than ArduPilot's CAM1_DURATION, 0.1 s by default
_SHOOT = (0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)


class Payload:
    """Gimbal, camera trigger, servos and other devices; methods return when the vehicle has accepted the command.

    Each raises AutopilotRefused if the vehicle has no such device, and AutopilotOverruled if the program has lost the
    vehicle.
    """

    def __init__(self, autopilot: Autopilot, thread: MissionThread, journal: Journal) -> None:
        self._autopilot = autopilot
        self._thread = thread
        self._journal = journal
        self._shoots_again_s = -math.inf
        # Pitch and yaw of the gimbal, once it was pointed.
        self.pointed_deg: tuple[float, float] | None = None

    def point_gimbal(self, *, pitch_deg: float, yaw_deg: float = 0.0) -> None:
        """Turns the gimbal: -90 looks straight down, 0 ahead; the yaw is relative to the vehicle's nose.

        Does not wait for the gimbal. Raises UsageError for a pitch beyond ±90 or a yaw beyond ±180 degrees.
        """
        for name, value, most in (("pitch_deg", pitch_deg, 90), ("yaw_deg", yaw_deg, 180)):
            if not abs(value) <= most:
                raise UsageError(f"point_gimbal: {name} is {value}: give degrees from -{most} to {most}")
        self.command(DO_GIMBAL_MANAGER_PITCHYAW, pitch_deg, yaw_deg, math.nan, math.nan)
        self.pointed_deg = pitch_deg, yaw_deg

    def trigger_camera(self) -> None:
        """Triggers the camera that is connected to the autopilot; the mission does not get the photo.

        A second trigger within 0.5 s waits: an ArduCopter accepts a trigger while the shutter is still held, and
        takes no photo.
        """
        self.command(DO_DIGICAM_CONTROL, *_SHOOT)

    def command(self, number: int, *parameters: float) -> None:
        """Sends a MAVLink command of a payload with up to seven parameters; the others are 0.

        Raises UsageError for a command that could move, arm or reconfigure the vehicle; docs/missions.md lists those
        that may be sent.
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
        if number in _SHOTS:
            await asyncio.sleep(max(0.0, self._shoots_again_s - now_s()))
        await self._autopilot.command(number, name, parameters)
        if number in _SHOTS:
            self._shoots_again_s = now_s() + _BETWEEN_SHOTS_S
        known = [value if math.isfinite(value) else None for value in parameters]
        self._journal.record(schema.PayloadCommanded(number=number, name=name, parameters=known))
