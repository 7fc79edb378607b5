"""The promise about landings: 27. Returns that hover and rally points are drawn as faults of the autopilot."""

from __future__ import annotations

from collections.abc import Iterator

from upwash.core.geo import Position, ground_distance_m
from upwash.core.vehicle.control import Owner
from upwash.eventlog import schema
from upwash.lab.faults.history import Breach, History

_NEAR_M = 5.0
_ROUNDING_M = 0.2
_TO_ALTER_RETURNS = ("hovers", "rally")


def landings(history: History) -> Iterator[Breach]:
    """A flight that returns is landed, the log says where, and the reserve is left at touchdown.

    Only flights whose autopilot has no other fault are judged, without a jump of the position. The reserve is not
    judged if the safe end is a landing on the spot, or if the battery is too small from the take-off on.
    """
    faults = [fault for fault in history.config.faults if fault.target == "autopilot"]
    if any(fault.kind not in _TO_ALTER_RETURNS for fault in faults) or history.position_jumps:
        return
    owner, landed, returns = Owner.NOBODY, None, None
    for event in history.run.events:
        match event:
            case schema.ControlChanged():
                owner = event.owner
            case schema.Landed():
                landed = event
                yield from _placed_wrong(event, history)
                yield from _below_reserve(event, history)
            case schema.Returning() | schema.SafeEnd(action="return"):
                returns, landed = event, None
    if returns is not None and landed is None and owner is Owner.PROGRAM and not history.run.vanished:
        yield returns, "the vehicle returned and was not landed"


def _placed_wrong(landed: schema.Landed, history: History) -> Iterator[Breach]:
    start = next((event.home for event in history.logged(schema.LimitsRead)), None)  # before arming
    points = [fault.moved_m for fault in history.config.faults if fault.kind == "rally"]
    places = {"home": start} | {
        f"rally point {number}": Position(*moved_m[:2]) for number, moved_m in enumerate(points, 1)
    }
    if landed.position is None or start is None:
        yield landed, "it does not say where the vehicle landed"
        return
    away_m = {name: ground_distance_m(landed.position, place) for name, place in places.items() if place}
    near = [name for name, at_m in away_m.items() if at_m <= _NEAR_M]
    if landed.at not in (near or [""]):
        yield landed, f"the vehicle is said to have landed at {landed.at or 'no place'}, and stands at {near}"
    if landed.from_home_m is None or abs(landed.from_home_m - away_m["home"]) > _ROUNDING_M:
        yield landed, f"the vehicle landed {away_m['home']:.1f} m from home, not {landed.from_home_m}"
    for over in history.own("flight_over"):
        if over.position is not None and ground_distance_m(over.position, landed.position) > _NEAR_M:
            yield landed, "the vehicle stands elsewhere"


def _below_reserve(landed: schema.Landed, history: History) -> Iterator[Breach]:
    endurance_s, reserve_s = history.config.vehicle.endurance_s, history.config.mission.reserve_s
    armed = next(history.logged(schema.Armed), None)
    lands = history.config.autopilot.on_failure == "land"
    first = next(history.logged(schema.Energy), None)
    too_small = first is not None and first.margin_percent < 0
    if endurance_s is None or reserve_s is None or armed is None or lands or too_small:
        return
    left_s = endurance_s - (landed.t - armed.t)
    if left_s < reserve_s:
        why = f"the battery lasts {left_s:.1f} s more at touchdown, less than the reserve of {reserve_s:g} s"
        yield landed, why
