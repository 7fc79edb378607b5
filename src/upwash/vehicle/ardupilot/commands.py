"""The commands that the stand-in knows, and what it answers to each: ArduCopter's, by its numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, Position
from upwash.core.vehicle.payload import PAYLOAD_COMMANDS
from upwash.mavlink.version import Version
from upwash.vehicle.ardupilot.boot import Text
from upwash.vehicle.ardupilot.copter import FORCED_ARM, FORCED_DISARM, Answer, Copter
from upwash.vehicle.ardupilot.flight import is_sensible
from upwash.vehicle.ardupilot.settings import CopterMode
from upwash.vehicle.body.firmware import Result

_RELATIVE = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
_ABOVE_SEA = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
_ACCEPTED = Answer(Result.ACCEPTED)
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


@dataclass(frozen=True, slots=True)
class VehicleCommand:
    """COMMAND_LONG and COMMAND_INT alike; `place` is parameters 5 to 7: degrees, and metres in the frame."""

    number: int
    parameters: tuple[float, float, float, float]
    place: tuple[float, float, float]
    frame: int
    shoots: bool = False  # parameter 5, as DO_DIGICAM_CONTROL means it


def read_command(message: Any) -> VehicleCommand:
    """The order in either message."""
    parameters = message.param1, message.param2, message.param3, message.param4
    if message.get_type() == "COMMAND_INT":
        place = message.x / 1e7, message.y / 1e7, message.z
        return VehicleCommand(message.command, parameters, place, message.frame, shoots=message.x == 1)
    place = message.param5, message.param6, message.param7
    frame = mavlink.MAV_FRAME_GLOBAL
    return VehicleCommand(message.command, parameters, place, frame, shoots=message.param5 == 1)


def obey(copter: Copter, now_s: float, command: VehicleCommand) -> Answer:
    """What the copter answers, having done what it was told if it could."""
    handler = _HANDLERS.get(command.number)
    if handler is None or copter.settings.version < _KNOWN_FROM.get(command.number, _FIRST):
        return Answer(Result.UNSUPPORTED)
    return handler(copter, now_s, command)


def change_mode(copter: Copter, now_s: float, *, base_mode: float, mode: float) -> Answer:
    """ArduCopter's own mode of that number; MAVLink's general ones are not understood."""
    if not _has_flag(base_mode, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED):
        return Answer(Result.DENIED)
    return copter.change_mode(now_s, mode)


def position_in_frame(
    copter: Copter, frame: int, *, latitude_deg: float, longitude_deg: float, altitude_m: float
) -> Position | None:
    """The position, relative to home; None in a frame that it does not know or at no place on the Earth."""
    if frame in _ABOVE_SEA:
        altitude_m -= copter.settings.home_altitude_m
    elif frame in _RELATIVE:
        altitude_m += copter.home.altitude_m
    else:
        return None
    if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
        return None
    return copter.frame.position(GeoPosition(latitude_deg, longitude_deg, altitude_m))


def _arm_or_disarm(copter: Copter, now_s: float, command: VehicleCommand) -> Answer:
    wish, magic = command.parameters[:2]
    if wish == 1:
        return copter.arm(now_s, forced=magic == FORCED_ARM)
    if wish == 0:
        return copter.disarm(now_s, forced=magic == FORCED_DISARM)
    return Answer(Result.UNSUPPORTED)


def _take_off(copter: Copter, now_s: float, command: VehicleCommand) -> Answer:
    return copter.take_off(now_s, command.place[2])


def _run_prearm_checks(copter: Copter, now_s: float, _order: VehicleCommand) -> Answer:
    """Says in words what it objects to; while it is armed there is nothing to check."""
    if copter.armed(now_s):
        return Answer(Result.TEMPORARILY_REJECTED)
    reasons = copter.why_not_armable(now_s)
    return Answer(Result.ACCEPTED, tuple(Text(f"PreArm: {reason}") for reason in reasons))


def _enter(mode: CopterMode) -> Handler:
    return lambda copter, now_s, _order: copter.change_mode(now_s, mode)


def _set_mode(copter: Copter, now_s: float, command: VehicleCommand) -> Answer:
    return change_mode(copter, now_s, base_mode=command.parameters[0], mode=command.parameters[1])


def _change_speed(copter: Copter, now_s: float, command: VehicleCommand) -> Answer:
    return copter.change_speed(now_s, command.parameters[1])


def _turn(copter: Copter, now_s: float, command: VehicleCommand) -> Answer:
    angle_deg, _, _, relative = command.parameters
    if not (0 <= angle_deg <= 360 and relative in (0, 1)):
        return Answer(Result.FAILED)
    return copter.turn(now_s, angle_deg + relative * copter.heading_deg(now_s))


def _set_home(copter: Copter, now_s: float, command: VehicleCommand) -> Answer:
    """Where it is, or at the place, whose altitude is above the sea unless the frame says otherwise."""
    if command.parameters[0] == 1:
        return copter.set_home(copter.position(now_s))
    latitude_deg, longitude_deg, altitude_m = command.place
    place = position_in_frame(
        copter, command.frame, latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_m=altitude_m
    )
    return Answer(Result.DENIED) if place is None else copter.set_home(place)


def _use_payload(_copter: Copter, _now_s: float, _command: VehicleCommand) -> Answer:
    """It carries one of everything."""
    return _ACCEPTED


def _record_video(_copter: Copter, _now_s: float, _command: VehicleCommand) -> Answer:
    """Its camera takes photos only."""
    return Answer(Result.FAILED)


def _control_camera(copter: Copter, now_s: float, command: VehicleCommand) -> Answer:
    """Accepted also where no photo is taken, as the shutter is still held from the last one."""
    if command.shoots:
        copter.camera.shoot(now_s, copter.position(now_s))
    return _ACCEPTED


def _take_photo(copter: Copter, now_s: float, _command: VehicleCommand) -> Answer:
    """Accepted only where a photo is taken."""
    return _ACCEPTED if copter.camera.shoot(now_s, copter.position(now_s)) else Answer(Result.FAILED)


def _reposition(copter: Copter, now_s: float, command: VehicleCommand) -> Answer:
    latitude_deg, longitude_deg, altitude_m = command.place
    target = position_in_frame(
        copter,
        command.frame,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_m=altitude_m,
    )
    if target is None or not is_sensible(target):
        return Answer(Result.DENIED)
    if copter.mode is not CopterMode.GUIDED:
        if not _has_flag(command.parameters[1], mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE):
            return Answer(Result.DENIED)
        answer = copter.change_mode(now_s, CopterMode.GUIDED)
        if answer.result is not Result.ACCEPTED:
            return answer
    if not copter.fence.allows(target):
        return Answer(Result.FAILED)
    copter.steer(now_s, target)
    return _ACCEPTED


def _has_flag(number: float, flag: int) -> bool:
    return math.isfinite(number) and bool(int(number) & flag)


Handler: TypeAlias = Callable[[Copter, float, VehicleCommand], Answer]

_HANDLERS: dict[int, Handler] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm_or_disarm,
    mavlink.MAV_CMD_NAV_TAKEOFF: _take_off,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: _enter(CopterMode.RTL),
    mavlink.MAV_CMD_NAV_LAND: _enter(CopterMode.LAND),
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: _enter(CopterMode.LOITER),
    mavlink.MAV_CMD_DO_SET_MODE: _set_mode,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: _change_speed,
    mavlink.MAV_CMD_DO_REPOSITION: _reposition,
    mavlink.MAV_CMD_DO_SET_HOME: _set_home,
    mavlink.MAV_CMD_RUN_PREARM_CHECKS: _run_prearm_checks,
    mavlink.MAV_CMD_CONDITION_YAW: _turn,
    **dict.fromkeys(PAYLOAD_COMMANDS.keys() - _UNKNOWN, _use_payload),
    mavlink.MAV_CMD_DO_DIGICAM_CONTROL: _control_camera,
    mavlink.MAV_CMD_IMAGE_START_CAPTURE: _take_photo,
    mavlink.MAV_CMD_VIDEO_START_CAPTURE: _record_video,
    mavlink.MAV_CMD_VIDEO_STOP_CAPTURE: _record_video,
}
