"""What is dangerous to a stand-in PX4, what its parameters call for then, and what it says when it acts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from upwash.mavlink.px4 import Mode
from upwash.vehicle.body.parameters import ParameterTable
from upwash.vehicle.px4.events import Tell
from upwash.vehicle.px4.failsafe import Action, Cause, Danger, FailsafeChange
from upwash.vehicle.px4.inputs import Px4Inputs

_FENCE_ACTIONS = {1: Action.WARN, 2: Action.HOLD, 3: Action.RTL, 4: Action.TERMINATE, 5: Action.LAND}
_OFFBOARD_ACTIONS = {
    0: Action.POSCTL,
    1: Action.ALTCTL,
    2: Action.STABILIZED,
    3: Action.RTL,
    4: Action.LAND,
    5: Action.HOLD,
    6: Action.TERMINATE,
    7: Action.DISARM,
}
_LINK_ACTIONS = {1: Action.HOLD, 2: Action.RTL, 3: Action.LAND, 5: Action.TERMINATE, 6: Action.DISARM}
_NAMED_CAUSES = {
    Cause.MANUAL_CONTROL: 1,
    Cause.GROUND_STATION: 2,
    Cause.CRITICAL_BATTERY: 4,
    Cause.EMERGENCY_BATTERY: 5,
}
_BLIND_MODES = (Mode.MANUAL, Mode.ALTCTL, Mode.ACRO, Mode.STABILIZED)  # they need no place


@dataclass(frozen=True, slots=True)
class Situation:
    """What it is about, and how it stands with it."""

    now_s: float
    intended: Mode
    grounded: bool
    placed: bool  # it knows where it is
    breached: bool  # its fence
    battery_level: int  # MAV_BATTERY_CHARGE_STATE


def dangers(situation: Situation, heard: Px4Inputs, parameters: ParameterTable) -> dict[Cause, Danger]:
    """What is dangerous now, and what each calls for."""
    return dict((*_links(situation, heard, parameters), *_itself(situation, parameters)))


def _links(
    situation: Situation, heard: Px4Inputs, parameters: ParameterTable
) -> Iterator[tuple[Cause, Danger]]:
    now_s, intended = situation.now_s, situation.intended
    if intended is Mode.OFFBOARD and situation.placed and not heard.hears_setpoints(now_s):
        action = _OFFBOARD_ACTIONS.get(round(parameters["COM_OBL_RC_ACT"]), Action.WARN)
        yield Cause.OFFBOARD, Danger(action, at_once=True)
    action_of = _LINK_ACTIONS.get(round(parameters["NAV_DLL_ACT"]))
    if action_of and heard.ground_station_at_arming and not heard.hears_ground_station(now_s):
        yield Cause.GROUND_STATION, Danger(action_of)
    action_of = _LINK_ACTIONS.get(round(parameters["NAV_RCL_ACT"]))
    lost = heard.sticks_at_arming and not heard.hears_sticks(now_s)
    if action_of and lost and not _forgives_lost_sticks(intended, parameters):
        yield Cause.MANUAL_CONTROL, Danger(action_of)


def _forgives_lost_sticks(intended: Mode, parameters: ParameterTable) -> bool:
    """COM_RCL_EXCEPT: whether lost sticks do not matter in this mode."""
    bit = {Mode.MISSION: 1, Mode.LOITER: 2, Mode.OFFBOARD: 4}.get(intended, 0)
    return bool(round(parameters["COM_RCL_EXCEPT"]) & bit)


def _itself(situation: Situation, parameters: ParameterTable) -> Iterator[tuple[Cause, Danger]]:
    level, choice = situation.battery_level, round(parameters["COM_LOW_BAT_ACT"])
    if level >= 2:
        yield Cause.LOW_BATTERY, Danger(Action.WARN)
    if level >= 3 and choice in (2, 3):
        yield Cause.CRITICAL_BATTERY, Danger(Action.LAND if choice == 2 else Action.RTL)
    if level >= 4 and choice in (2, 3):
        yield Cause.EMERGENCY_BATTERY, Danger(Action.LAND)
    if situation.breached and (action_of := _FENCE_ACTIONS.get(round(parameters["GF_ACTION"]))):
        yield Cause.GEOFENCE, Danger(action_of, sticks=True)
    if not situation.placed and situation.intended not in _BLIND_MODES and not situation.grounded:
        yield Cause.POSITION, Danger(Action.DESCEND, at_once=True)


def announce(
    change: FailsafeChange, *, intended: Mode, breaches: list[str], delay_s: float, tell: Tell
) -> None:
    """Tells what a fail-safe begins, after a delay in Hold where it waits."""
    if change.action is Action.WARN:
        if change.cause is Cause.LOW_BATTERY:
            tell("commander_failsafe_enter_low_bat")
        return
    if change.cause is Cause.GEOFENCE:
        for name in breaches:
            tell(name, 2**32 - 1, 20)
    named = _NAMED_CAUSES.get(change.cause)
    cause = (named,) if named else ()
    if change.waits:
        event = "commander_failsafe_enter_hold" if named else "commander_failsafe_enter_generic_hold"
        tell(event, intended, change.action, round(delay_s), *cause)
    elif change.action is Action.DESCEND:
        tell("commander_failsafe_enter_autopilot_disengaged", intended, change.action)
    else:
        event = "commander_failsafe_enter" if named else "commander_failsafe_enter_generic"
        tell(event, intended, change.action, *cause)
