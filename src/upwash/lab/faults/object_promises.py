"""The promise about objects: 28, one act for each, at its place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from upwash.config.world import ObjectConfig
from upwash.core.geo import Position, ground_distance_m
from upwash.eventlog import schema
from upwash.eventlog.progress import CallPlaces
from upwash.lab.faults.history import Breach, History
from upwash.report.findings import Finder

_NEAR_M = 6.0  # drawn objects with one label are twice as far apart
_LEGS = 1  # from an answer until the user gets it: a flight to a waypoint may be under way


def one_act_each(history: History) -> Iterator[Breach]:
    """Each object in the answers has one act, at its place, and the user gets each answer when it comes."""
    if not history.draws_objects:
        return
    yield from _told_late(history)
    if history.position_jumps:
        return
    assert history.config.event is not None  # noqa: S101 - it draws objects
    drawn, acted = history.config.event.objects, Counter[int]()
    for event in history.logged(schema.Notified):
        if isinstance(event.message, dict) and "acted" in event.message:
            number = _nearest(drawn, str(event.message["acted"]), event.at)
            if number is None:
                yield event, f"an action on {event.message['acted']} was done where none is"
                continue
            acted[number] += 1
            if acted[number] > 1:
                yield event, f"object {number} was acted on {acted[number]} times"
    if history.run.result.completed:
        found = _found(history.run.events, drawn)
        if missed := sorted(found - acted.keys()):
            yield None, f"objects {missed} were found, and not acted on"


def _found(events: Sequence[schema.Event], drawn: Sequence[ObjectConfig]) -> set[int]:
    finder = Finder()
    findings = [finding for event in events for finding in finder.take(event) if finding.own is not None]
    numbers = {_nearest(drawn, finding.what, finding.place) for finding in findings}
    return {number for number in numbers if number is not None}


def _nearest(drawn: Sequence[ObjectConfig], label: str, place: Position) -> int | None:
    away_m = {
        number: ground_distance_m(place, Position(each.east_m, each.north_m))
        for number, each in enumerate(drawn)
        if each.label == label
    }
    nearest = min(away_m, key=away_m.__getitem__, default=None)
    return nearest if nearest is not None and away_m[nearest] <= _NEAR_M else None


def _told_late(history: History) -> Iterator[Breach]:
    """The user gets an answer before the drone has flown another leg of its plan; legs to acts do not count."""
    whereabouts, legs = CallPlaces(), dict[int | None, int]()
    for event in history.run.events:
        whereabouts.take(event)
        match event:
            case schema.Call():
                legs[whereabouts.of_call] = 0
            case schema.Arrived(waypoint=int()):
                legs = {waypoint: flown + 1 for waypoint, flown in legs.items()}
            case schema.Notified(message={"told": int(waypoint)}):
                if legs.pop(waypoint, 0) > _LEGS:
                    why = f"the answer of waypoint {waypoint} was told {_LEGS + 1} waypoints after it came"
                    yield event, why
