"""Checks before the motors run: the firmware's version and abilities, and PX4's fail-safe settings.

Each check raises AutopilotRefused before arming. A vehicle that does not tell its version is flown if it has what
upwash needs.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition
from upwash.errors import AutopilotRefused
from upwash.eventlog.schema import VehicleSetting
from upwash.mavlink.packets import Message
from upwash.mavlink.px4 import CURRENT_MODE
from upwash.mavlink.version import Version
from upwash.real.mavlink.parameters import VehicleQuantity, read_quantities
from upwash.real.mavlink.vehicle import MavlinkVehicle

_STEP = "arm"
_TIMES = 3
_CAPABILITIES = 1  # of MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: send the version
_NOWHERE = GeoPosition(91.0, 181.0)


def _setting(name: str, unit: str, without: str) -> VehicleQuantity:
    return VehicleQuantity("", {name: 1.0}, unit, None, without=without)


_LOST = _setting(
    "COM_OBL_RC_ACT",
    "",
    "what the vehicle does when the program or its link is lost is not known: it may fall",
)
_NOTICES_AFTER = _setting(
    "COM_OF_LOSS_T", "s", "how soon the vehicle notices that the program or its link is lost is not known"
)
_OVERRIDE = _setting("COM_RC_OVERRIDE", "", "whether sticks take the vehicle from the program is not known")
_DELAY = VehicleQuantity("the time before a fail-safe acts", {"COM_FAIL_ACT_T": 1.0}, "s", 5.0)
_FALLS = {6.0: "terminate", 7.0: "disarm"}
_GOES_ON = (3.0, 5.0)
_STICKS_IN_OFFBOARD = 2
_LONG_S = 10.0


async def ask_version(vehicle: MavlinkVehicle) -> Version | None:
    """The version of the vehicle's firmware; None if the vehicle does not tell it."""
    answers: list[Version | None] = []

    def hear(message: Message) -> None:
        if message.get_type() == "AUTOPILOT_VERSION":
            answers.append(Version.of(message.flight_sw_version))

    questions = (
        lambda: vehicle.ask_for(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION),
        # for firmwares that do not know MAV_CMD_REQUEST_MESSAGE
        lambda: vehicle.question(mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, _CAPABILITIES),
    )
    with vehicle.listening(hear):
        for ask in questions * _TIMES:
            if await vehicle.answered("version", ask, lambda: answers, times=1):
                return answers[-1]
    return None


def require_version(vehicle: MavlinkVehicle) -> None:
    """Raises AutopilotRefused for a version older than the oldest that can be flown."""
    version, firmware = vehicle.version, vehicle.firmware
    if version is not None and version.numbers < firmware.oldest.numbers:
        raise _refused(f"the vehicle runs {firmware.name} {version}", vehicle)


async def require_reposition(vehicle: MavlinkVehicle) -> None:
    """Raises AutopilotRefused if the vehicle does not know MAV_CMD_DO_REPOSITION.

    The vehicle is disarmed, and the program's. The command names a place that is not on the Earth, and lacks the flag
    that would change the mode. A firmware that knows the command denies it: ArduCopter's
    handle_command_int_do_reposition looks at the mode and at the place first.
    """
    vehicle.require_control(_STEP)
    if vehicle.telemetry.armed:
        return
    frame, reposition = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, mavlink.MAV_CMD_DO_REPOSITION
    result = await vehicle.result(_STEP, vehicle.command_int(reposition, _NOWHERE, frame))
    if result == mavlink.MAV_RESULT_UNSUPPORTED:
        raise _refused(f"{_described(vehicle)} does not know MAV_CMD_DO_REPOSITION", vehicle)


async def require_current_mode(vehicle: MavlinkVehicle) -> None:
    """Raises AutopilotRefused if the vehicle does not report CURRENT_MODE."""

    reported = await vehicle.answered(
        _STEP,
        lambda: vehicle.ask_for(CURRENT_MODE),
        lambda: vehicle.heard_since(CURRENT_MODE, 0.0),
        times=vehicle.patience.attempts,
    )
    if not reported:
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


async def check_px4_settings(vehicle: MavlinkVehicle) -> None:
    """Report what a PX4 does if it loses the program; AutopilotRefused if the vehicle would fall."""
    values = await read_quantities(vehicle, (_LOST, _NOTICES_AFTER, _OVERRIDE))
    lost, after_s, override = values.known(_LOST), values.known(_NOTICES_AFTER), values.known(_OVERRIDE)
    if lost in _FALLS:
        raise AutopilotRefused(
            _STEP,
            f"COM_OBL_RC_ACT is {lost:g} ({_FALLS[lost]}): the vehicle falls when the program or its link is "
            "lost; set it to 3 (return) or 5 (hover); nothing was sent",
        )
    if lost is not None and lost not in _GOES_ON:
        what = "comes down where it is, unless a pilot has it by stick" if lost in (0, 1, 2) else "lands"
        advice = f"without the program the vehicle {what}; 3 has it return, 5 hover"
        vehicle.news.tell(VehicleSetting(name="COM_OBL_RC_ACT", value=lost, advice=advice))
    if after_s is not None and after_s > _LONG_S:
        advice = "the vehicle notices the loss only after that many seconds"
        vehicle.news.tell(VehicleSetting(name="COM_OF_LOSS_T", value=after_s, advice=advice))
    if override is not None and not int(override) & _STICKS_IN_OFFBOARD:
        advice = (
            "sticks do not take the vehicle from the program, a mode switch does; 3 has sticks do it, too"
        )
        vehicle.news.tell(VehicleSetting(name="COM_RC_OVERRIDE", value=override, advice=advice))


async def px4_failsafe_delay_s(vehicle: MavlinkVehicle) -> float:
    """The time that a PX4 hovers before a fail-safe acts."""
    return (await read_quantities(vehicle, (_DELAY,)))[_DELAY]
