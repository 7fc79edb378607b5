"""PX4's side of a stand-in's connections."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position, Velocity
from upwash.mavlink.packets import Message
from upwash.mavlink.px4 import (
    AVAILABLE_MODES,
    CURRENT_MODE,
    CUSTOM_MODE_FLAG,
    event_text,
)
from upwash.mavlink.version import Version
from upwash.vehicle.body.copter import is_sensible
from upwash.vehicle.body.fence import FenceTransfer, TransferRules
from upwash.vehicle.body.firmware import StandInFirmware, position_in_frame
from upwash.vehicle.px4.commands import obey, set_mode
from upwash.vehicle.px4.inputs import InputSource, Setpoint, Sticks
from upwash.vehicle.px4.navigator import LOWEST_M
from upwash.vehicle.px4.telemetry import UNASKED_S, UNMODELLED, Px4Telemetry, available_modes
from upwash.vehicle.px4.vehicle import Quadrotor

_HEARTBEAT_S, _STATUS_S = 1.0, 0.5
_CHECKS_AT_MOST_EVERY_S = 2.0
_SEVERITY_OF_PROGRAMS = 8
_NO_EAST_NORTH, _NO_ALTITUDE, _NO_VELOCITY, _NO_YAW = 0b11, 0b100, 0b111_000, 1 << 10
_STICK_FULL = 1000.0
_TELLS_MODES_FROM = Version(1, 15, kind=0)
_ALL_MODES = 2**32 - 1
# The summaries of the checks, as recorded: their bits are not modelled.
_SUMMARY_WELL = (0, 1048576, 128, 2155822000, 2155822000)
_SUMMARY_ILL = (0, 17956864, 128, 2147564416, 2147564416)
_HEALTH_WELL, _HEALTH_ILL = (0, 939658250, 0, 0), (0, 939658242, 0, 0)


class Px4Firmware(StandInFirmware[Quadrotor]):
    """A quadrotor that reports, obeys and speaks as PX4 does on an onboard link."""

    unasked_s = UNASKED_S
    told_of_home = (mavlink.MAVLINK_MSG_ID_HOME_POSITION,)
    wakes_every_s = 0.05
    texts_only_to_ground_stations = True

    def __init__(self, copter: Quadrotor) -> None:
        known = Px4Telemetry(copter).reports()
        if copter.settings.version < _TELLS_MODES_FROM:
            del known[AVAILABLE_MODES], known[CURRENT_MODE]
        known |= dict.fromkeys(UNMODELLED, lambda _now_s: None)
        rally = copter.settings.rally
        super().__init__(copter, known, FenceTransfer(copter.frame, copter.fence, _FENCE_RULES, rally=rally))
        self._beats_s: float | None = None
        self._checked: tuple[object, bool] | None = None
        self._checks_s = -math.inf

    def live(self, now_s: float) -> Iterator[Message]:
        """The messages due now that nobody requested: the heartbeat, events and texts."""
        self.copter.advance(now_s)
        if self._beats_s is None or now_s >= self._beats_s:
            begun_s = now_s if self._beats_s is None else self._beats_s
            self._beats_s = max(begun_s + _HEARTBEAT_S, now_s)
            yield from self.report(now_s, mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        self._check(now_s)
        yield from self.said()
        yield from self._fence.missing(now_s)

    def obey(self, now_s: float, message: Message) -> tuple[int, ...]:
        """One answer, or two; events tell everyone the reasons."""
        self.copter.advance(now_s)
        results = obey(self.copter, now_s, message)
        if message.command == mavlink.MAV_CMD_RUN_PREARM_CHECKS and results[0] == 0:
            self._tell_checks(now_s)
        return results

    def update_of(self, now_s: float, number: float) -> object:
        """CURRENT_MODE is sent when a mode changes, and twice a second (vehicle_status of Commander.cpp)."""
        if number != CURRENT_MODE:
            return None
        self.copter.advance(now_s)
        return self.copter.mode, self.copter.intended, math.floor(now_s / _STATUS_S)

    def requested(self, now_s: float, message: Message) -> Iterable[Message]:
        """The report of that number; AVAILABLE_MODES by index, 0 for all."""
        if message.param1 == AVAILABLE_MODES and AVAILABLE_MODES in self.reports:
            index = message.param2
            return available_modes(int(index)) if math.isfinite(index) and 0 <= index < 2**16 else ()
        return self.report(now_s, message.param1)

    def set_parameter(self, now_s: float, name: str, value: float) -> Iterable[Message]:
        """Sets the parameter, and lowers those that must not exceed it; yields messages about the lowered ones."""
        self.copter.advance(now_s)
        if self.copter.parameters.receive(name, value) and name == "MPC_XY_VEL_MAX":
            lowered = (
                ("MPC_XY_CRUISE", "mc_pos_ctrl_cruise_set"),
                ("MPC_VEL_MANUAL", "mc_pos_ctrl_man_vel_set"),
            )
            for limited, event in lowered:
                most = self.copter.parameters[name]
                if self.copter.parameters[limited] > most and self.copter.parameters.change(limited, most):
                    self.copter.happened(event, most)
                    yield self.copter.parameters.named(limited)
        yield from self.said()

    # --- what happened --------------------------------------------------------------------------------------

    def said(self) -> Iterator[Message]:
        """The messages for all peers since the last call: events, and the texts of those for people."""
        for event in self.copter.said():
            yield event
            text = event_text(event)
            if event.severity < _SEVERITY_OF_PROGRAMS and text:
                yield mavlink.MAVLink_statustext_message(event.severity, f"{text}\t".encode()[:50])

    def _check(self, now_s: float) -> None:
        """Tells the objections of its checks when they change, and not too often."""
        if not self.copter.checked(now_s) or now_s < self._checks_s + _CHECKS_AT_MOST_EVERY_S:
            return
        if (self._objections(now_s), self.copter.gps.placed) != self._checked:
            self._tell_checks(now_s)

    def _tell_checks(self, now_s: float) -> None:
        copter, objections = self.copter, self._objections(now_s)
        self._checked, self._checks_s = (objections, copter.gps.placed), now_s
        summary = _SUMMARY_WELL if copter.gps.placed else _SUMMARY_ILL
        copter.happened("commander_arming_check_summary", *summary)
        for name, (modes, component) in objections.items():
            serious = name == "check_rc_dl_no_dllink" and copter.parameters["NAV_DLL_ACT"]
            copter.happened(name, modes, component, log_levels=0x33 if serious else None)
        copter.happened("commander_health_summary", *(_HEALTH_WELL if copter.gps.has_fix else _HEALTH_ILL))

    def _objections(self, now_s: float) -> dict[str, tuple[int, int]]:
        """The failed checks; for each the modes that it concerns and its health component, as recorded."""
        gps, inputs, level = self.copter.gps, self.copter.inputs, self.copter.battery_level(now_s)
        checks = (
            ("check_estimator_gps_fix_too_low", not gps.has_fix and not gps.placed, 8257660, 3),
            ("check_modes_local_pos", not gps.placed, 8257660, 17),
            ("check_modes_global_pos", not gps.placed, 56, 24),
            ("check_modes_mission", True, 8, 20),
            ("check_modes_offboard_signal", not self.copter.hears_setpoints(now_s), 16384, 20),
            ("check_modes_home_position", not gps.ever_had_fix, 32, 20),
            ("check_modes_manual_control", not inputs.hears(InputSource.STICKS, now_s), _ALL_MODES, 7),
            ("check_rc_dl_no_dllink", not inputs.hears(InputSource.GROUND_STATION, now_s), _ALL_MODES, 12),
            ("check_battery_low", level == 2, _ALL_MODES, 11),
            ("check_battery_critical", level == 3, _ALL_MODES, 11),
            ("check_battery_emergency", level == 4, _ALL_MODES, 11),
        )
        objections = {name: (modes, component) for name, fails, modes, component in checks if fails}
        breaches = () if self.copter.armed else self.copter.breaches()  # in flight the fail-safe tells them
        return objections | dict.fromkeys(breaches, (_ALL_MODES, 20))

    # --- who is there, and what they want -------------------------------------------------------------------

    def _hear_heartbeat(self, now_s: float, message: Message) -> None:
        if message.type == mavlink.MAV_TYPE_GCS:
            self.copter.hear(InputSource.GROUND_STATION, now_s)
        elif message.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER:
            self.copter.hear(InputSource.COMPANION, now_s)

    def _hear_mode(self, now_s: float, message: Message) -> None:
        number = message.custom_mode
        if message.base_mode & CUSTOM_MODE_FLAG:
            main, sub = number >> 16 & 0xFF, number >> 24
            set_mode(self.copter, base_mode=message.base_mode, main=main, sub=sub)

    def _hear_sticks(self, now_s: float, message: Message) -> None:
        axes = [axis / _STICK_FULL for axis in (message.x, message.y, message.r)]
        if message.target in (0, 1) and all(abs(axis) <= 1 for axis in axes):
            throttle = min(max(message.z, 0.0), _STICK_FULL)
            self.copter.move_sticks(now_s, Sticks(axes[0], axes[1], axes[2], throttle))

    def _hear_local_setpoint(self, now_s: float, message: Message) -> None:
        if message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED:
            self._follow(now_s, message, Position(message.y, message.x, -message.z))

    def _hear_global_setpoint(self, now_s: float, message: Message) -> None:
        home_m = self.copter.home_altitude_m() - self.copter.settings.home_altitude_m
        told = message.lat_int / 1e7, message.lon_int / 1e7, message.alt
        place = position_in_frame(self.copter, message.coordinate_frame, told, home_m=home_m)
        if place is not None:
            self._follow(now_s, message, place)

    def _follow(self, now_s: float, message: Message, place: Position) -> None:
        mask = message.type_mask
        setpoint = Setpoint(
            east_north_m=None if mask & _NO_EAST_NORTH else (place.east_m, place.north_m),
            altitude_m=None if mask & _NO_ALTITUDE else place.altitude_m,
            velocity=None if mask & _NO_VELOCITY else Velocity(message.vy, message.vx, -message.vz),
            yaw_deg=None if mask & _NO_YAW else math.degrees(message.yaw),
        )
        if _makes_sense(setpoint):
            self.copter.follow(now_s, setpoint)

    listeners: ClassVar = {
        "HEARTBEAT": _hear_heartbeat,
        "SET_MODE": _hear_mode,
        "MANUAL_CONTROL": _hear_sticks,
        "SET_POSITION_TARGET_LOCAL_NED": _hear_local_setpoint,
        "SET_POSITION_TARGET_GLOBAL_INT": _hear_global_setpoint,
    }


_FENCE_RULES = TransferRules(
    most_items=100,
    request=mavlink.MAVLink_mission_request_int_message,
    unasked=mavlink.MAV_MISSION_ERROR,
    out_of_turn=None,
    refuse=lambda _: mavlink.MAV_MISSION_INVALID,  # it keeps the fence that it has
    asks_again_s=0.25,
)


def _makes_sense(setpoint: Setpoint) -> bool:
    """Whether it sets a place or a velocity, and one within reach."""
    velocity, place = setpoint.velocity, setpoint.east_north_m
    if velocity is None and place is None and setpoint.altitude_m is None:
        return False
    numbers = [setpoint.yaw_deg or 0.0, *(place or ()), setpoint.altitude_m or 0.0]
    if velocity is not None:
        numbers += [velocity.east_m_s, velocity.north_m_s, velocity.up_m_s]
    if not all(math.isfinite(number) for number in numbers):
        return False
    there = Position(*(place or (0.0, 0.0)), setpoint.altitude_m or 0.0)
    return is_sensible(there, lowest_m=LOWEST_M)
