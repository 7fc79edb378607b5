"""The commands that the stand-in knows, and its answer to each: ArduCopter's, by its numbers."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position
from upwash.core.vehicle.payload import PAYLOAD_COMMANDS
from upwash.mavlink.version import Version
from upwash.vehicle.ardupilot.copter import FORCED_ARM, FORCED_DISARM, Copter
from upwash.vehicle.ardupilot.settings import CopterMode
from upwash.vehicle.body.copter import Result, is_sensible
from upwash.vehicle.body.firmware import Handler, VehicleCommand, arming, position_in_frame

_UNKNOWN = frozenset(
    {
        mavlink.MAV_CMD_DO_SET_ACTUATOR,
        mavlink.MAV_CMD_ILLUMINATOR_ON_OFF,
        mavlink.MAV_CMD_SET_CAMERA_MODE,
        mavlink.MAV_CMD_DO_TRIGGER_CONTROL,
        mavlink.MAV_CMD_USER_1,
        mavlink.MAV_CMD_USER_2,
        mavlink.MAV_CMD_USER_3,
        mavlink.MAV_CMD_USER_4,
        mavlink.MAV_CMD_USER_5,
    }
)  # commands of payloads that ArduCopter has no handler for
_FIRST = Version(0, 0, kind=0)
_KNOWN_FROM = {mavlink.MAV_CMD_DO_REPOSITION: Version(4, 1, kind=0)}


def obey(copter: Copter, now_s: float, command: VehicleCommand) -> Result:
    """Carries the command out, if the copter can; returns its answer."""
    handler = _HANDLERS.get(command.number)
    if handler is None or copter.settings.version < _KNOWN_FROM.get(command.number, _FIRST):
        return Result.UNSUPPORTED
    return handler(copter, now_s, command)


def change_mode(copter: Copter, now_s: float, *, base_mode: float, mode: float) -> Result:
    """Changes to ArduCopter's mode `mode`; denied without the flag of custom modes in `base_mode`."""
    if not _has_flag(base_mode, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED):
        return Result.DENIED
    return copter.change_mode(now_s, mode)


def place_of(copter: Copter, frame: int, place: tuple[float, float, float]) -> Position | None:
    """The position of a place in that frame of MAVLink; None where it has none."""
    return position_in_frame(copter, frame, place, home_m=copter.home.altitude_m)


def _run_prearm_checks(copter: Copter, now_s: float, _command: VehicleCommand) -> Result:
    """Answers with the failed checks as texts; TEMPORARILY_REJECTED while the copter is armed."""
    if copter.armed(now_s):
        return Result.TEMPORARILY_REJECTED
    copter.tell_objections(now_s)
    return Result.ACCEPTED


def _enter(mode: CopterMode) -> Handler:
    return lambda copter, now_s, _command: copter.change_mode(now_s, mode)


def _turn(copter: Copter, now_s: float, command: VehicleCommand) -> Result:
    """Turns the nose to the angle until the next target; no effect unless the copter flies in GUIDED."""
    angle_deg, _, _, relative = command.parameters
    if not (0 <= angle_deg <= 360 and relative in (0, 1)):
        return Result.FAILED
    copter.turn_to(now_s, (angle_deg + relative * copter.heading_deg(now_s)) % 360)
    return Result.ACCEPTED


def _set_home(copter: Copter, now_s: float, command: VehicleCommand) -> Result:
    """Sets home to the present position or the command's place; denied if that place has no position."""
    if command.parameters[0] == 1:
        return copter.set_home(copter.position(now_s))
    place = place_of(copter, command.frame, command.place)
    return Result.DENIED if place is None else copter.set_home(place)


def _control_camera(copter: Copter, now_s: float, command: VehicleCommand) -> Result:
    """Takes a photo; also accepted while the shutter is still held, when no photo is taken."""
    if command.shoots:
        copter.shoot(now_s)
    return Result.ACCEPTED


def _reposition(copter: Copter, now_s: float, command: VehicleCommand) -> Result:
    target = place_of(copter, command.frame, command.place)
    if target is None or not is_sensible(target):
        return Result.DENIED
    if copter.mode is not CopterMode.GUIDED:
        if not _has_flag(command.parameters[1], mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE):
            return Result.DENIED
        result = copter.change_mode(now_s, CopterMode.GUIDED)
        if result is not Result.ACCEPTED:
            return result
    if not copter.fence.allows(target):
        return Result.FAILED
    copter.steer(now_s, target)
    return Result.ACCEPTED


def _has_flag(number: float, flag: int) -> bool:
    return math.isfinite(number) and bool(int(number) & flag)


_HANDLERS: dict[int, Handler] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: arming(FORCED_ARM, FORCED_DISARM),
    mavlink.MAV_CMD_NAV_TAKEOFF: lambda copter, now_s, command: copter.take_off(now_s, command.place[2]),
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: _enter(CopterMode.RTL),
    mavlink.MAV_CMD_NAV_LAND: _enter(CopterMode.LAND),
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: _enter(CopterMode.LOITER),
    mavlink.MAV_CMD_DO_SET_MODE: lambda copter, now_s, command: change_mode(
        copter, now_s, base_mode=command.parameters[0], mode=command.parameters[1]
    ),
    mavlink.MAV_CMD_DO_CHANGE_SPEED: lambda copter, now_s, command: copter.change_speed(
        now_s, command.parameters[1]
    ),
    mavlink.MAV_CMD_DO_REPOSITION: _reposition,
    mavlink.MAV_CMD_DO_SET_HOME: _set_home,
    mavlink.MAV_CMD_RUN_PREARM_CHECKS: _run_prearm_checks,
    mavlink.MAV_CMD_CONDITION_YAW: _turn,
    # It carries one payload of each kind. Its camera takes photos only.
    **dict.fromkeys(PAYLOAD_COMMANDS.keys() - _UNKNOWN, lambda *_: Result.ACCEPTED),
    mavlink.MAV_CMD_DO_DIGICAM_CONTROL: _control_camera,
    mavlink.MAV_CMD_IMAGE_START_CAPTURE: lambda copter, now_s, _: (
        Result.ACCEPTED if copter.shoot(now_s) else Result.FAILED
    ),
    mavlink.MAV_CMD_VIDEO_START_CAPTURE: lambda *_: Result.FAILED,
    mavlink.MAV_CMD_VIDEO_STOP_CAPTURE: lambda *_: Result.FAILED,
}
