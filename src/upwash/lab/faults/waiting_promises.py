"""The promise about calls of services that only servers run: 24."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import msgspec

from upwash.drone.resumption import waypoints_done
from upwash.eventlog import schema
from upwash.lab.faults.history import SLACK_S, Breach, History
from upwash.lab.faults.mission import HASTY_S, CallReport, Surveyor, is_hasty


def only_servers(history: History) -> Iterator[Breach]:
    """Never on the drone; one end for each call, in time; the mission hears what ended it; nothing is lost."""
    if not history.asks_servers:
        return
    for fact in history.own("computed"):
        yield fact, "the drone computed a call that only servers run"
    for event in history.logged(schema.LocalReady):
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
    for event in history.logged(schema.CallStarted):
        if not ended[event.waypoint]:
            yield event, f"the call of waypoint {event.waypoint} never ends"


def _heard(history: History) -> Iterator[Breach]:
    """The mission sends its user one message for the end of the call, which fits that end."""
    unanswered = {event.waypoint for event in history.logged(schema.Unanswered)}
    heard = Counter[int]()
    for event in history.logged(schema.Notified):
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
        for started in history.logged(schema.CallStarted):
            if not heard[started.waypoint or 0]:
                yield started, f"the mission never hears about {started.waypoint}"


def _lost_in_a_crash(history: History) -> Iterator[Breach]:
    """Killed at any moment, a started call whose end the mission has not heard is made again."""
    for event, kept in history.crashes(schema.AnswerTaken):
        open_ones = {each.waypoint for each in kept if isinstance(each, schema.CallStarted)}
        open_ones -= {each.waypoint for each in kept if isinstance(each, schema.AnswerTaken)}
        for waypoint in waypoints_done(kept, history.config) & open_ones:
            yield event, f"killed before this, waypoint {waypoint} would not be visited again"
