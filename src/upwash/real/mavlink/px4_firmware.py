"""The meaning of a PX4's reports, modes, fail-safes and events."""

from __future__ import annotations

import csv
import struct
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.eventlog.schema import VehicleSaid
from upwash.mavlink.packets import Message
from upwash.mavlink.px4 import CURRENT_MODE, Mode, event_text, px4_events
from upwash.mavlink.version import Version
from upwash.real.mavlink.telemetry import STREAMS_HZ, FirmwareProfile, VehicleTelemetry

LOITER, TAKEOFF, RTL, LAND, OFFBOARD = "AUTO.LOITER", "AUTO.TAKEOFF", "AUTO.RTL", "AUTO.LAND", "OFFBOARD"
_AUTO = (Mode.TAKEOFF, Mode.LOITER, Mode.MISSION, Mode.RTL, Mode.LAND)
_NAMES = {mode.value: f"AUTO.{mode.name}" if mode in _AUTO else mode.name for mode in Mode}
MODES = {name: Mode(number) for number, name in _NAMES.items()}
_STATES = {
    Mode.MANUAL: 0,
    Mode.ALTCTL: 1,
    Mode.POSCTL: 2,
    Mode.MISSION: 3,
    Mode.LOITER: 4,
    Mode.RTL: 5,
    Mode.ACRO: 10,
    Mode.OFFBOARD: 14,
    Mode.STABILIZED: 15,
    Mode.TAKEOFF: 17,
    Mode.LAND: 18,
}  # PX4's navigation states: the bits in what its checks say of modes
LOITER_STATE = 1 << _STATES[Mode.LOITER]
_CHECKS_BEGIN, _CHECKS_END = "commander_arming_check_summary", "commander_health_summary"
_CHECK = "check_"
_OFFBOARD_SIGNAL, _PLACES = "check_modes_offboard_signal", ("check_modes_local_pos", "check_modes_global_pos")
_CHECK_ARGUMENTS = struct.Struct("<IB")  # the modes that it concerns, and the component


_SWITCHING, _ANY_FAILSAFE, _FENCE = ": switching to", "fail-safe", "geofence: "
_SETPOINTS_BACK = (Mode.OFFBOARD, Mode.OFFBOARD)


def _mode_name(number: int) -> str:
    return _NAMES.get(number, f"number {number:#x}")


def failsafe(telemetry: VehicleTelemetry, _mode: str) -> str:
    """Why a fail-safe may have chosen the mode; "" without one.

    In a fail-safe the commanded mode differs from the flown mode, or the system status is critical. After the loss
    of setpoints PX4 goes back to OFFBOARD by itself, as soon as one comes.
    """
    modes = telemetry.flown_and_intended_mode
    if modes is not None and modes[0] == telemetry.mode:
        flown, intended = modes
        if intended in (0, flown):
            return "its fail-safe is over" if telemetry.failsafe_over else ""
        return f"a fail-safe chose it{_cause(telemetry)}, {_mode_name(intended)} was set"
    critical = telemetry.system_status == mavlink.MAV_STATE_CRITICAL
    return "its system status is critical" if critical else ""


def _cause(telemetry: VehicleTelemetry) -> str:
    """The cause in brackets: what the fail-safe said, or an invalid position; "" if nothing tells it."""
    for text in telemetry.warned_of_mode():
        cause, switching, _ = text.partition(_SWITCHING)
        if text.startswith(_FENCE) or (switching and cause != _ANY_FAILSAFE):
            return f" ({cause})"
    for number, _ in _failed(telemetry, _PLACES):
        return f" ({words_of(number)})"
    return " (it does not know its position)" if telemetry.knows_its_place is False else ""


def _take(telemetry: VehicleTelemetry, message: Message, now_s: float) -> None:
    match message.get_type():
        case "CURRENT_MODE":
            before, modes = (
                telemetry.flown_and_intended_mode,
                (message.custom_mode, message.intended_custom_mode),
            )
            if before is None or modes != before:
                telemetry.failsafe_over = (
                    modes == _SETPOINTS_BACK and before is not None and before[1] == modes[1]
                )
            telemetry.flown_and_intended_mode = modes
            if not telemetry.on_ground:  # when it disarms itself, its mode changes too: a HEARTBEAT has both
                telemetry.change_mode(message.custom_mode, now_s)
        case "SYS_STATUS":  # it lists the check among the healthy sensors only, not among the present ones
            health = message.onboard_control_sensors_health
            telemetry.can_be_armed = bool(health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
        case "ESTIMATOR_STATUS":  # on the ground it reports its position as constant
            doubts = 0 if telemetry.on_ground else mavlink.ESTIMATOR_CONST_POS_MODE
            flags, doubts = message.flags, doubts | mavlink.ESTIMATOR_GPS_GLITCH
            telemetry.knows_its_place = bool(flags & mavlink.ESTIMATOR_POS_HORIZ_ABS) and not flags & doubts
        case "EVENT":
            _take_event(telemetry, message, now_s)


def _take_event(telemetry: VehicleTelemetry, event: Any, now_s: float) -> None:
    """Take in an event; failed checks come as a whole set after each change, of which the last event may be lost."""
    number, name = event.id_of_event, _event_name(event.id_of_event)
    if name == _CHECKS_BEGIN:
        _hear_checks(telemetry, now_s)
        telemetry.armable_modes = px4_events()[number].unpacked(event.arguments)[3]
        telemetry.failed_checks = {}
    elif name.startswith(_CHECK):
        telemetry.failed_checks[number] = event.severity, _CHECK_ARGUMENTS.unpack_from(event.arguments)[0]
    elif name == _CHECKS_END:
        _hear_checks(telemetry, now_s)
    elif number in px4_events():
        _hear(telemetry, event.severity, event_text(event), now_s)
    else:
        _hear(telemetry, event.severity, words_of(number), now_s)


def _hear_checks(telemetry: VehicleTelemetry, now_s: float) -> None:
    """Report the failed checks that concern the flown mode and were not in the last set.

    PX4 calls the signal for OFFBOARD lost when the setpoints need a position and the position is not valid
    (offboardCheck.cpp), though the setpoints come: the failed check of the position says why.
    """
    before, telemetry.failed_checks_before = telemetry.failed_checks_before, telemetry.failed_checks
    if not telemetry.armed:
        return
    for number, (severity, modes) in telemetry.failed_checks.items():
        if number in before or not _concerns(modes, telemetry.mode):
            continue
        causes = _failed(telemetry, _PLACES) if _event_name(number) == _OFFBOARD_SIGNAL else []
        cause, how_severe = causes[0] if causes else (number, severity)
        _hear(telemetry, how_severe, words_of(cause), now_s)


def _failed(telemetry: VehicleTelemetry, names: Sequence[str]) -> list[tuple[int, int]]:
    """The checks of these names that failed, by number, each with its severity."""
    failed = {
        _event_name(number): (number, severity) for number, (severity, _) in telemetry.failed_checks.items()
    }
    return [failed[name] for name in names if name in failed]


def _concerns(modes: int, mode: int | None) -> bool:
    """Whether a failed check is for the mode that is flown."""
    state = _STATES.get(Mode(mode)) if mode in _NAMES else None
    return state is None or bool(modes >> state & 1)


def _hear(telemetry: VehicleTelemetry, severity: int, text: str, now_s: float) -> None:
    if severity <= mavlink.MAV_SEVERITY_DEBUG:  # what is less severe is for programs
        telemetry.hear_text(VehicleSaid(severity=severity, text=text), now_s)


def words_of(number: int) -> str:
    """The text of the event of that number."""
    if kind := px4_events().get(number):
        return kind.text
    name = _event_name(number)
    return f"{name.removeprefix(_CHECK).replace('_', ' ')} (event {number})" if name else f"event {number}"


def _event_name(number: int) -> str:
    kind = px4_events().get(number)
    return kind.name if kind else _event_names().get(number, "")


@cache
def _event_names() -> Mapping[int, str]:
    """The names of PX4 1.16.1's events by number, from bench/px4_events.py."""
    with resources.files("upwash.real.mavlink").joinpath("px4_events.csv").open(encoding="utf-8") as table:
        return {int(row["number"]): row["name"] for row in csv.DictReader(table)}


PX4 = FirmwareProfile(
    name="PX4",
    autopilot=mavlink.MAV_AUTOPILOT_PX4,
    own_mode=LOITER,  # OFFBOARD needs setpoints: only a running program can be in it
    mode_name=_mode_name,
    failsafe=failsafe,
    take=_take,
    streams_hz={
        CURRENT_MODE: 50.0,  # so that a change is sent at once
        **STREAMS_HZ,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
        mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 2.0,
    },
    always_has="SYS_AUTOSTART",
    oldest=Version(1, 15),
    needs="CURRENT_MODE over MAVLink 2",
    sent_at_times=frozenset(
        {
            CURRENT_MODE,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
            mavlink.MAVLINK_MSG_ID_RC_CHANNELS,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        }
    ),
    sent_anyway_hz={CURRENT_MODE: 2.0},
    sends_parameters_as_bytes=True,
)
