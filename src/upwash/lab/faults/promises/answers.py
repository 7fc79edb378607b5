"""Promise 19: what an answer demands is done at its waypoint, once, and no crash loses it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import msgspec

from upwash.config import waypoints
from upwash.core.geo import Position, ground_distance_m
from upwash.drone.resumption import waypoints_done
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults.mission import Done, demands_something
from upwash.lab.faults.promises.history import Breach, History, position_jumps

_AT_PLACE_M = 1.0  # within which a vehicle counts as arrived
_MOST_CRASHES = 12  # that a flight is tested with


def answers(history: History) -> Iterator[Breach]:
    """Goes by what a mission told that may fly on before it has its answer; another one has no such answers."""
    if not history.config.mission.program.endswith(":look_later"):
        return
    places = [each.position for each in waypoints(history.config.mission)]
    yield from _done_twice(history.run.events)
    if not position_jumps(history.config):
        yield from _done_elsewhere(history.run.events, places)
        yield from _flown_back_too_far(history.run.events, places)
    yield from _lost_in_a_crash(history)
    for event in history.run.events:
        if isinstance(event, schema.StayOrGo) and event.goes and event.waypoint == len(places) - 1:
            yield event, "it flew on from the last waypoint"
    if history.run.result.completed:
        done = sorted(each.done for _, each in _done(history.run.events))
        wanted = [number for number in range(len(places)) if demands_something(number)]
        if done != wanted:
            yield None, f"actions {wanted} were demanded, and {done} done"


def _done_elsewhere(events: Sequence[Event], places: Sequence[Position]) -> Iterator[Breach]:
    for event, action in _done(events):
        if ground_distance_m(event.at, places[action.done]) > _AT_PLACE_M:
            yield event, f"action {action.done} was done beside its waypoint"


def _done_twice(events: Sequence[Event]) -> Iterator[Breach]:
    told = set[int]()
    for event, action in _done(events):
        if action.done in told:
            yield event, f"action {action.done} was done twice"
        told.add(action.done)
    logged = [event.waypoint for event in events if isinstance(event, schema.Acted)]
    if len(set(logged)) != len(logged):
        yield None, f"the log has an action twice: {logged}"


def _done(events: Sequence[Event]) -> Iterator[tuple[schema.Notified, Done]]:
    for event in events:
        if isinstance(event, schema.Notified) and isinstance(event.message, dict) and "done" in event.message:
            yield event, msgspec.convert(event.message, Done)


def _flown_back_too_far(events: Sequence[Event], places: Sequence[Position]) -> Iterator[Breach]:
    for event in events:
        if isinstance(event, schema.TurnedBack) and event.waypoint is not None:
            leg_m = ground_distance_m(places[event.waypoint], places[event.waypoint + 1])
            if ground_distance_m(event.position, places[event.waypoint]) > leg_m + _AT_PLACE_M:
                yield event, f"it flew back to waypoint {event.waypoint} from beyond the next one"


def _lost_in_a_crash(history: History) -> Iterator[Breach]:
    """Had the program been killed then, a waypoint whose answer or action is missing would be visited again."""
    events: Sequence[Event] = history.run.events
    if history.run.result.completed:
        events = [event for event in events if not isinstance(event, schema.MissionCompleted)]
    moments = [
        number
        for number, event in enumerate(events)
        if isinstance(
            event, (schema.CallStarted, schema.SetOff, schema.AnswerTaken, schema.Notified, schema.Acted)
        )
    ]
    for number in moments[:: max(1, len(moments) // _MOST_CRASHES)]:
        kept = events[:number]
        acted = {event.waypoint for event in kept if isinstance(event, schema.Acted)}
        settled = {
            event.waypoint for event in kept if isinstance(event, schema.AnswerTaken) and not event.demanded
        }
        for waypoint in waypoints_done(kept, history.config) - acted - settled:
            yield events[number], f"killed before this, waypoint {waypoint} would not be visited again"
