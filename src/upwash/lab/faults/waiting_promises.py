"""The promise about calls of services that only servers run: 24."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import msgspec

from upwash.drone.resumption import waypoints_done
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults.history import SLACK_S, Breach, History, asks_servers
from upwash.lab.faults.mission import HASTY_S, CallReport, Surveyor, is_hasty

_MOST_CRASHES = 12  # moments of a flight, with a kill at each


def only_servers(history: History) -> Iterator[Breach]:
    """Never on the drone; one end for each call, in time; the mission hears what ended it; nothing is lost."""
    if not asks_servers(history.config):
        return
    for fact in history.own("computed"):
        yield fact, "the drone computed a call that only servers run"
    for event in history.run.events:
        if isinstance(event, schema.LocalReady):
            yield event, "an instance that only servers run started on the drone"
    yield from _ends(history)
    yield from _heard(history)
    yield from _lost_in_a_crash(history)


def _ends(history: History) -> Iterator[Breach]:
    ended = Counter[int | None]()
    for event in history.run.events:
        match event:
            case schema.Call():
                took_s = event.delay_s
                if event.server is None:
                    yield event, "this call was answered by the drone"
            case schema.Unanswered():
                took_s = event.waited_s
            case _:
                continue
        ended[event.waypoint] += 1
        if ended[event.waypoint] > 1:
            yield event, f"the call of waypoint {event.waypoint} ends a second time"
        number = event.waypoint
        if number is not None and is_hasty(number) and took_s > HASTY_S + SLACK_S:
            yield event, f"the call took {took_s:.3f} s of at most {HASTY_S:g} s"
    if not history.run.result.completed:
        return
    for event in history.run.events:
        if isinstance(event, schema.CallStarted) and not ended[event.waypoint]:
            yield event, f"the call of waypoint {event.waypoint} never ends"


def _heard(history: History) -> Iterator[Breach]:
    """The mission sends its user one message for the end of the call, which fits that end."""
    unanswered = {event.waypoint for event in history.run.events if isinstance(event, schema.Unanswered)}
    heard = Counter[int]()
    for event in history.run.events:
        if not isinstance(event, schema.Notified):
            continue
        try:
            report = msgspec.convert(event.message, CallReport)
        except msgspec.ValidationError:  # of an action
            continue
        heard[report.asked] += 1
        if heard[report.asked] > 1:
            yield event, f"the mission hears a second time about {report.asked}"
        wanted = None if report.asked in unanswered else Surveyor().survey(report.asked)
        if report.answer != wanted:
            yield event, f"the mission hears {report.answer} about {report.asked}, and {wanted} is right"
    if history.run.result.completed:
        for event in history.run.events:
            if isinstance(event, schema.CallStarted) and not heard[event.waypoint or 0]:
                yield event, f"the mission never hears about {event.waypoint}"


def _lost_in_a_crash(history: History) -> Iterator[Breach]:
    """Killed at any moment, a started call whose end the mission has not heard is made again."""
    events: list[Event] = list(history.run.events)
    moments = [number for number, event in enumerate(events) if isinstance(event, schema.AnswerTaken)]
    for number in moments[:: max(1, len(moments) // _MOST_CRASHES)]:
        kept = events[:number]
        open_ones = {event.waypoint for event in kept if isinstance(event, schema.CallStarted)}
        open_ones -= {event.waypoint for event in kept if isinstance(event, schema.AnswerTaken)}
        for waypoint in waypoints_done(kept, history.config) & open_ones:
            yield events[number], f"killed before this, waypoint {waypoint} would not be visited again"
