"""The commands that the stand-in PX4 knows, and its answer to each."""

from __future__ import annotations

import math
from dataclasses import replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition
from upwash.core.vehicle.payload import PAYLOAD_COMMANDS
from upwash.mavlink.packets import Message
from upwash.mavlink.px4 import Mode
from upwash.vehicle.body.copter import Result
from upwash.vehicle.body.firmware import Handler, VehicleCommand, arming, read_command
from upwash.vehicle.px4.navigator import Reposition
from upwash.vehicle.px4.vehicle import FORCED, Quadrotor

_IGNORED_E7 = 2**31 - 1  # of a coordinate in COMMAND_INT: not given
_NAN_E7 = 0x7FF80000  # a NaN that was sent as an integer by mistake
_UNKNOWN = frozenset(
    {
        mavlink.MAV_CMD_VIDEO_START_CAPTURE,
        mavlink.MAV_CMD_VIDEO_STOP_CAPTURE,
        mavlink.MAV_CMD_USER_1,
        mavlink.MAV_CMD_USER_2,
        mavlink.MAV_CMD_USER_3,
        mavlink.MAV_CMD_USER_4,
        mavlink.MAV_CMD_USER_5,
    }
)  # commands of payloads that PX4 has no handler for
_MAIN_AUTO = Mode.LOITER.main
_MODES = {(mode.main, mode.sub): mode for mode in Mode}


def obey(copter: Quadrotor, now_s: float, message: Message) -> tuple[Result, ...]:
    """Carries the command out, if the copter can; returns its answers."""
    handler = _HANDLERS.get(message.command)
    if handler is None:
        return (Result.UNSUPPORTED,)
    command = _read(message)
    if command is None:
        return (Result.DENIED,)
    result = handler(copter, now_s, command)
    # The first of two answers says that the command has arrived.
    return (Result.ACCEPTED, result) if message.command == mavlink.MAV_CMD_DO_SET_MODE else (result,)


def set_mode(copter: Quadrotor, *, base_mode: float, main: float, sub: float) -> Result:
    """Changes the mode; a mode that does not exist is accepted and means nothing, as with PX4."""
    if not _byte(base_mode) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return Result.ACCEPTED
    main, sub = _byte(main), _byte(sub)
    if main != _MAIN_AUTO:
        sub = 0
    elif sub == 0:
        sub = Mode.MISSION.sub
    mode = _MODES.get((main, sub))
    if mode is None:
        return Result.TEMPORARILY_REJECTED if main == _MAIN_AUTO else Result.ACCEPTED
    return copter.set_mode(mode)


def _read(message: Message) -> VehicleCommand | None:
    """The command, with NaN for a place that COMMAND_INT does not give; None for a place sent by mistake."""
    command = read_command(message)
    if message.get_type() == "COMMAND_INT" and message.x == message.y:
        if message.x == _NAN_E7:
            return None
        if message.x == _IGNORED_E7:
            return replace(command, place=(math.nan, math.nan, message.z))
    return command


def _take_off(copter: Quadrotor, _now_s: float, command: VehicleCommand) -> Result:
    return copter.take_off(command.place[2] - copter.settings.home_altitude_m)


def _enter(mode: Mode) -> Handler:
    return lambda copter, _now_s, _command: copter.set_mode(mode)


def _do_set_mode(copter: Quadrotor, _now_s: float, command: VehicleCommand) -> Result:
    base_mode, main, sub, _ = command.parameters
    return set_mode(copter, base_mode=base_mode, main=main, sub=sub)


def _reposition(copter: Quadrotor, now_s: float, command: VehicleCommand) -> Result:
    speed_m_s, flags, _, yaw_deg = command.parameters
    if flags != mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE:
        return Result.UNSUPPORTED
    latitude_deg, longitude_deg, above_sea_m = command.place
    if math.isinf(above_sea_m):
        return Result.DENIED
    east_north_m = None
    if math.isfinite(latitude_deg) and math.isfinite(longitude_deg):
        if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
            return Result.DENIED
        place = copter.frame.position(GeoPosition(latitude_deg, longitude_deg))
        east_north_m = place.east_m, place.north_m
    wish = Reposition(
        east_north_m=east_north_m,
        altitude_m=None if math.isnan(above_sea_m) else above_sea_m - copter.settings.home_altitude_m,
        speed_m_s=speed_m_s,
        yaw_deg=yaw_deg if math.isfinite(yaw_deg) else None,
    )
    return copter.reposition(now_s, wish)


def _run_checks(copter: Quadrotor, _now_s: float, _command: VehicleCommand) -> Result:
    return Result.TEMPORARILY_REJECTED if copter.armed else Result.ACCEPTED


def _byte(number: float) -> int:
    return int(number) if math.isfinite(number) and 0 <= number <= 255 else 0


_HANDLERS: dict[int, Handler] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: arming(FORCED, FORCED),
    mavlink.MAV_CMD_NAV_TAKEOFF: _take_off,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: _enter(Mode.RTL),
    mavlink.MAV_CMD_NAV_LAND: _enter(Mode.LAND),
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: _enter(Mode.LOITER),
    mavlink.MAV_CMD_DO_SET_MODE: _do_set_mode,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: lambda copter, _now_s, command: copter.change_speed(
        command.parameters[1]
    ),
    mavlink.MAV_CMD_DO_REPOSITION: _reposition,
    mavlink.MAV_CMD_RUN_PREARM_CHECKS: _run_checks,
    # It carries one payload of each kind.
    **dict.fromkeys(PAYLOAD_COMMANDS.keys() - _UNKNOWN, lambda *_: Result.ACCEPTED),
}
