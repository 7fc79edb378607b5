"""Promises about rows that a drone flies without stopping: 23."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from upwash.config.places import waypoints
from upwash.core.geo import distance_m
from upwash.core.knowledge.servers import State
from upwash.core.operation import ON_DRONE, name_of
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults.history import ROUNDING_S, Breach, FlownCall, History

_AT_SPOT_M = 1.0
_BESIDE_M = 5.0  # as a vehicle whose position jumped to and fro may pass a spot
_LATE_S = 0.5  # of flight, after which a spot that was missed is flown back to


def on_the_move(history: History) -> Iterator[Breach]:
    """Photos at their spots, few enough open, one call at a place, in line, nothing open on the way home."""
    if not history.flies_rows:
        return
    led_away = any(fault.kind == "diverted" for fault in history.config.faults)  # perhaps in a silence
    if not led_away:
        yield from _photos_elsewhere(history)
    yield from _too_many_open(history)
    yield from _two_at_a_place(history)
    yield from _out_of_line(history)
    yield from _sought_too_often(history)
    yield from _home_too_early(history.run.events)
    yield from _left_unsaid(history)


def _photos_elsewhere(history: History) -> Iterator[Breach]:
    """Each photo is of the waypoint that the drone has just reached, and each waypoint has one.

    Places are not judged if the position jumped between arrival and photo, or before that within a silence.
    """
    config = history.config
    unheard_s = next((fact.t for fact in history.own("jumped_unheard")), math.inf)
    spots = {waypoint.index: waypoint for waypoint in waypoints(config.mission)}
    late_m = max(_AT_SPOT_M, _LATE_S * config.mission.ground_speed_m_s) + 0.1
    near_m = _BESIDE_M if history.position_jumps else late_m
    here: int | None = None
    jumped = False
    photos = set[int]()
    for event in history.run.events:
        if isinstance(event, schema.Arrived):
            here, jumped = event.waypoint, False
        elif isinstance(event, schema.PositionDoubted):
            jumped = True
        elif isinstance(event, schema.PhotoTaken) and here is not None:
            photos.add(here)
            if jumped or event.t >= unheard_s:
                continue
            if (off_m := distance_m(event.position, spots[here].position)) > near_m:
                yield event, f"the photo of waypoint {here} was taken {off_m:.1f} m from there"
    if history.run.result.completed and len(photos) < len(spots):
        yield None, f"waypoints {sorted(spots.keys() - photos)} have no photo"


def _too_many_open(history: History) -> Iterator[Breach]:
    photos = history.config.mission.photos
    assert photos is not None  # noqa: S101 - it flies rows
    open_ones, heard = 0, set[int | None]()
    for event in history.run.events:
        if isinstance(event, schema.CallStarted):
            open_ones += 1
            if open_ones > photos.at_most:
                yield event, f"{open_ones} photos are open, and at most {photos.at_most} may be"
        elif isinstance(event, schema.FirstAnswer | schema.PutOff) and event.waypoint not in heard:
            heard.add(event.waypoint)
            open_ones -= 1
        elif isinstance(event, schema.AnswerTaken) and event.waypoint not in heard:
            open_ones -= 1


def _two_at_a_place(history: History) -> Iterator[Breach]:
    """From the decision for a place until the answer, no other call is decided for it."""
    until_s: dict[str, float] = {}
    placed = [part for call in history.calls for part in _placed(call)]
    for decided, place, to_s in sorted(placed, key=lambda part: part[0].t):
        if decided.t < until_s.get(place, 0.0) - ROUNDING_S:
            why = f"this was decided for {place}, which had an earlier call until {until_s[place]:.3f} s"
            yield decided, why
        until_s[place] = max(until_s.get(place, 0.0), to_s)


def _placed(call: FlownCall) -> Iterator[tuple[schema.Decided, str, float]]:
    """The decision for each place of the call, and until when it had the place.

    Where a call has two answers these are the drone, and the server of the better one. A server that gets a call
    beside the drone has it until its own answer. How long a loser has the call the log does not tell.
    """
    ended, tried = call.ended, [decided for decided in call.decisions if decided.decision != "wait"]
    if not tried:
        return
    for decided in tried:
        if decided.raced and decided.server not in (None, ended.server):
            yield decided, name_of(decided.server), decided.t
    place = ON_DRONE if tried[0].raced else tried[0].server or ON_DRONE
    beside = [decided for decided in tried if decided.raced and decided.server == ended.server]
    if ended.first_s is None:
        left = call.queued if call.queued is not None and call.queued.server == place else ended
        yield tried[0], place, left.t
        if beside:
            yield beside[-1], name_of(ended.server), ended.t
        return
    first_at_s = ended.t - ended.delay_s + ended.first_s
    if place == ON_DRONE and tried[0].t < first_at_s:  # else the drone began it while a server was waited for
        yield tried[0], place, first_at_s
    if ended.server is not None:
        last = next(decided for decided in reversed(tried) if decided.server == ended.server)
        yield last, ended.server, ended.t


def _out_of_line(history: History) -> Iterator[Breach]:
    """A call is decided before those behind it, except those that the drone answers before a server gets to them.

    A call that the mission waits for is before all others.
    """
    photos = history.config.mission.photos
    assert photos is not None  # noqa: S101 - it flies rows
    urgent = _waits_for(history)
    in_line: dict[int | None, schema.CallStarted] = {}
    for event in history.run.events:
        if isinstance(event, schema.CallStarted):
            in_line[event.waypoint] = event
        elif isinstance(event, schema.Decided) and event.waypoint in in_line:
            begun = in_line.pop(event.waypoint)
            before = [
                other
                for other in in_line.values()
                if other.t < event.t - ROUNDING_S
                and (other.t < begun.t if photos.order == "oldest" else other.t > begun.t)
            ]
            if not _may_be_decided(event, begun, before, two=bool(history.within_s)):
                where = f"{len(before)} calls before it: {list(in_line)}"
                yield event, f"waypoint {event.waypoint} was not the {photos.order} in line, with {where}"
            for waypoint, from_s, to_s in urgent:
                if from_s + ROUNDING_S < event.t < to_s - ROUNDING_S and not _is_beside(event):
                    why = f"the mission waited for the call of waypoint {waypoint}, and this was decided"
                    yield event, why
        elif isinstance(event, schema.AnswerTaken):
            in_line.pop(event.waypoint, None)


def _may_be_decided(
    event: schema.Decided, begun: schema.CallStarted, before: Sequence[schema.CallStarted], *, two: bool
) -> bool:
    """Whether it may be decided with these calls before it in line.

    Without a server that is ready none may be before it. With one, calls of the same operation are judged by the
    times of the log.
    """
    if event.state != State.READY:
        return not before
    alike = [other for other in before if other.operation == begun.operation == event.operation]
    if not alike:
        return True
    local_s, remote_s, queue_s = event.local_s or 0.0, event.remote_s or 0.0, event.queue_s or 0.0
    if not _is_beside(event):  # the drone gets to those before it sooner than the server
        return queue_s > 0 and len(alike) * local_s - ROUNDING_S <= queue_s + remote_s
    if queue_s > 0:  # which was another when the server got its last call
        return len(alike) * remote_s - ROUNDING_S <= local_s
    return two or len(alike) * remote_s - ROUNDING_S <= local_s <= (2 + len(before)) * remote_s + ROUNDING_S


def _is_beside(event: schema.Decided) -> bool:
    """Whether the drone takes the call while the server in use, which is ready, takes those before it."""
    return event.decision == "local" and event.state == State.READY


def _waits_for(history: History) -> list[tuple[int | None, float, float]]:
    """For each call that the mission waited for: its waypoint, its begin, and its decision, in seconds."""
    started = {event.waypoint for event in history.logged(schema.CallStarted)}
    return [
        (call.ended.waypoint, call.ended.at_s, call.decisions[0].t)
        for call in history.calls
        if call.ended.waypoint not in started and call.decisions
    ]


def _sought_too_often(history: History) -> Iterator[Breach]:
    """A drone that rests flies to the range of each server once at most, until it takes another photo."""
    servers, sought = len(history.config.servers), 0
    for event in history.logged(schema.CallStarted, schema.SoughtAnswers):
        sought = sought + 1 if isinstance(event, schema.SoughtAnswers) else 0
        if sought > servers:
            yield event, f"this is place {sought} that it flew to for answers, with {servers} servers"


def _home_too_early(events: Sequence[Event]) -> Iterator[Breach]:
    """By the mission, that is: the safe end of a flight waits for nothing."""
    open_ones = dict[int | None, str]()
    for event in events:
        match event:
            case schema.CallStarted(waypoint=waypoint):
                open_ones[waypoint] = "answer"
            case schema.AnswerTaken(waypoint=waypoint, demanded=demanded):
                open_ones.pop(waypoint, None)
                if demanded:
                    open_ones[waypoint] = "demand"
            case schema.Acted(waypoint=waypoint):
                open_ones.pop(waypoint, None)
            case schema.SafeEnd() | schema.Stopping() | schema.ControlChanged(owner="pilot"):
                return
            case schema.Returning() | schema.Landing() if open_ones:
                yield event, f"it set off for home with these open: {open_ones}"


def _left_unsaid(history: History) -> Iterator[Breach]:
    """The result of a flight that ended early names each waypoint whose answer or action is due."""
    if history.run.result.completed:
        return
    due = set[int | None]()
    for event in history.run.events:
        match event:
            case schema.CallStarted(waypoint=waypoint):
                due.add(waypoint)
            case schema.AnswerTaken(waypoint=waypoint, demanded=False):
                due.discard(waypoint)
            case schema.Acted(waypoint=waypoint):
                due.discard(waypoint)
    result = history.run.result
    if unsaid := due - {*result.not_acted_on, *result.failed_calls, *result.not_looked_at}:
        yield None, f"the result says nothing of what is due at waypoints {sorted(map(str, unsaid))}"
