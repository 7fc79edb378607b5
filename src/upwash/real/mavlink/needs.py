"""What a firmware has to know for a flight, found out while the vehicle stands: by its version, and by asking.

Each check raises AutopilotRefused before the motors run. A vehicle that does not tell its version is flown if it
knows what upwash needs.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition
from upwash.errors import AutopilotRefused
from upwash.mavlink.px4 import CURRENT_MODE
from upwash.mavlink.version import Version
from upwash.real.mavlink.hearing import Message
from upwash.real.mavlink.vehicle import MavlinkVehicle

_STEP = "arm"
_TIMES = 3
_CAPABILITIES = 1  # of MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: send the version
_NOWHERE = GeoPosition(91.0, 181.0)
_EVER = 0.0


async def ask_version(vehicle: MavlinkVehicle) -> Version | None:
    """The version of the vehicle's firmware; None if the vehicle does not tell it."""
    told: list[Version | None] = []

    def hear(message: Message) -> None:
        if message.get_type() == "AUTOPILOT_VERSION":
            told.append(Version.of(message.flight_sw_version))

    with vehicle.listening(hear):
        for _ in range(_TIMES):
            for ask in (_ask, _ask_as_before):
                ask(vehicle)
                if await vehicle.happens("version", lambda: bool(told), within_s=vehicle.patience.answer_s):
                    return told[-1]
    return None


def _ask(vehicle: MavlinkVehicle) -> None:
    vehicle.ask_for(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)


def _ask_as_before(vehicle: MavlinkVehicle) -> None:
    """The same for firmwares that do not know MAV_CMD_REQUEST_MESSAGE."""
    vehicle.question(mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, _CAPABILITIES)


def require_version(vehicle: MavlinkVehicle) -> None:
    """Refuses a version that is older than the oldest that can be flown."""
    version, firmware = vehicle.version, vehicle.firmware
    if version is not None and version.numbers < firmware.oldest.numbers:
        raise _refused(f"the vehicle runs {firmware.name} {version}", vehicle)


async def require_reposition(vehicle: MavlinkVehicle) -> None:
    """Refuses a vehicle that does not know MAV_CMD_DO_REPOSITION.

    The vehicle is disarmed, and the program's. The command names a place that is not on the Earth, and lacks the flag
    that would change the mode. A firmware that knows the command denies it: ArduCopter's
    handle_command_int_do_reposition looks at the mode and at the place first.
    """
    vehicle.require_control(_STEP)
    if vehicle.telemetry.armed:
        return
    frame, reposition = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, mavlink.MAV_CMD_DO_REPOSITION
    result = await vehicle.result_at(_STEP, reposition, _NOWHERE, frame=frame)
    if result == mavlink.MAV_RESULT_UNSUPPORTED:
        raise _refused(f"{_described(vehicle)} does not know MAV_CMD_DO_REPOSITION", vehicle)


async def require_current_mode(vehicle: MavlinkVehicle) -> None:
    """Refuses a vehicle that does not report CURRENT_MODE."""

    def reported() -> bool:
        return vehicle.heard_since(CURRENT_MODE, _EVER)

    for _ in range(vehicle.patience.attempts):
        if reported():
            return
        vehicle.ask_for(CURRENT_MODE)
        await vehicle.happens(_STEP, reported, within_s=vehicle.patience.answer_s)
    if not reported():
        raise _refused(f"{_described(vehicle)} does not report CURRENT_MODE", vehicle)


def _described(vehicle: MavlinkVehicle) -> str:
    version = "of a version that it does not tell" if vehicle.version is None else str(vehicle.version)
    return f"the vehicle, {vehicle.firmware.name} {version},"


def _refused(what: str, vehicle: MavlinkVehicle) -> AutopilotRefused:
    firmware = vehicle.firmware
    return AutopilotRefused(
        _STEP,
        f"{what}; upwash flies {firmware.name} {firmware.oldest} and newer, with {firmware.needs}: update the "
        "vehicle's firmware; it was not armed",
    )
