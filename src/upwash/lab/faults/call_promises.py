"""Promises about calls: 2, their bounds, 3, their answers, 4, their errors, and 19, what answers demand."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence

import msgspec

from upwash.config.drone import DroneConfig
from upwash.config.places import waypoints
from upwash.core.geo import Position, ground_distance_m
from upwash.core.planning.demand_map import DemandMap
from upwash.drone.resumption import waypoints_done
from upwash.eventlog import schema
from upwash.eventlog.progress import CallPlaces
from upwash.eventlog.schema import Event
from upwash.lab.faults import mission as probing
from upwash.lab.faults.history import ROUNDING_S, SLACK_S, Breach, FlownCall, History, deadline_of, service_of
from upwash.lab.faults.mission import ActionReport, demands_something, is_waited_for
from upwash.lab.observer import Observation
from upwash.support.text import counted

_REMOTE_LEAST_S, _REMOTE_FACTOR = 1.0, 4.0  # of the deadline of a remote call


def bounded_calls(history: History) -> Iterator[Breach]:
    """The longest worthwhile wait, the remote deadline and one local call, each as the rules say."""
    policy, first = history.config.policy, set(map(id, _first_calls(history.run.events)))
    computed: dict[str, deque[Observation]] = {}  # by service, as a hedged call may outlast one of another
    for fact in history.own("computed"):
        computed.setdefault(service_of(fact), deque()).append(fact)
    calls = history.calls
    before_s: dict[str, float] = {}  # of the last hedged call, by service
    if not history.seen:  # without an observer: no longer than the longest in the log
        for call in calls:
            service = service_of(call.ended)
            before_s[service] = max(before_s.get(service, 0.0), call.ended.onboard_s)
    for call in calls:
        ended = call.ended
        if ended.delay_s > call.bound_s:
            yield ended, f"took {ended.delay_s:.3f} s of at most {call.bound_s:.3f} s"
        for decided in call.decisions:
            patient = policy.patient_first_call and id(decided) in first
            yield from _allowed_too_much(decided, policy.gain_wait, patient=patient)
        yield from _hedged_too_late(call)
        service = service_of(ended)
        most_s = math.inf if history.flies_rows else before_s.get(service, 0.0)  # in line with others
        if call.queued_s > most_s + SLACK_S:
            yield ended, f"waited {call.queued_s:.3f} s for a service that needed {most_s:.3f} s"
        if history.flies_rows and (not ended.onboard_s or history.within_s):
            continue  # it was in line until a server answered it; or calls do not end in the order of computing
        if computed.get(service) and call.computed:
            before_s[service] = took_s = computed[service].popleft().took_s
            if ended.onboard_s > took_s + SLACK_S:
                why = f"spent {ended.onboard_s:.3f} s on the drone, whose service took {took_s:.3f} s"
                yield ended, why


def _first_calls(events: Iterable[Event]) -> Iterator[schema.Decided]:
    """The decisions for a server whose service has answered no call since its last start."""
    warm: dict[str, set[str]] = {}  # services by server
    asked: dict[tuple[int | None, str], str] = {}  # the server that a call of a waypoint was last sent to
    for event in events:
        match event:
            case schema.Call(remote_fault="confirmed", waypoint=waypoint):
                warm.setdefault(asked[waypoint, service_of(event)], set()).add(service_of(event))
            case schema.Started(server=server) | schema.Prepared(server=server):
                warm[server] = set()
            case schema.Call(server=str(server)):
                warm.setdefault(server, set()).add(service_of(event))
            case schema.Decided(decision="remote", server=str(server), waypoint=waypoint):
                asked[waypoint, service_of(event)] = server
                if service_of(event) not in warm.get(server, set()):
                    yield event


def _allowed_too_much(decided: schema.Decided, gain_wait: float, *, patient: bool) -> Iterator[Breach]:
    if decided.decision == "local" or decided.raced:  # which costs no time
        return
    if decided.local_s is None or decided.remote_s is None:
        yield decided, "was decided without estimates"
        return
    if decided.at_most_s is not None:
        longest_s = decided.local_s * (1 - gain_wait) - decided.remote_s
        if decided.at_most_s > longest_s + ROUNDING_S:
            yield decided, f"may wait {decided.at_most_s:.3f} s, worthwhile are {longest_s:.3f} s"
    else:
        expected_s = math.inf if patient else _REMOTE_FACTOR * decided.remote_s
        longest_s = max(_REMOTE_LEAST_S, min(expected_s, decided.local_s)) + (decided.queue_s or 0.0)
        if (deadline_s := deadline_of(decided)) > longest_s + ROUNDING_S:
            yield decided, f"has a deadline of {deadline_s:.3f} s, allowed are {longest_s:.3f} s"


def _hedged_too_late(call: FlownCall) -> Iterator[Breach]:
    """The onboard service must start within a server's deadline, which a hedge extends by at most one local call."""
    hedged, decided = call.hedged, call.sent
    if hedged is None or decided is None:
        return
    deadline_s = deadline_of(decided)
    if hedged.after_s > deadline_s + ROUNDING_S:
        yield hedged, f"starts {hedged.after_s:.3f} s into a call whose deadline is {deadline_s:.3f} s"
    longest_s = max(deadline_s, hedged.after_s + (decided.local_s or 0.0))
    if hedged.deadline_s > longest_s + ROUNDING_S:
        yield hedged, f"has a deadline of {hedged.deadline_s:.3f} s, allowed are {longest_s:.3f} s"


def one_answer(history: History) -> Iterator[Breach]:
    """One result a call, its own; a server's within the deadline."""
    for call in history.calls:
        yield from _unbelievable(call)
    if history.within_s:
        yield from _two_answers(history)
        return
    told, known = list(_told(history)), set[int]()
    in_any_order = history.flies_rows or _acts_later(history)
    for number, (event, heard) in enumerate(told):
        if in_any_order:
            if heard.asked in known:
                yield event, f"this is about call {heard.asked}, whose answer was there before"
            known.add(heard.asked)
        elif heard.asked != number:
            yield event, f"this is about call {heard.asked}, but number {number} was to come"
        if heard.raised:
            continue
        if heard != _expected(history.config, heard.asked):
            yield event, f"call {heard.asked} was answered by {heard.answer}, which is another call's answer"
    if not _is_probing(history.config):
        return
    calls, open_ones = len(history.run.result.calls), _answers_open(history)
    if not calls - open_ones <= len(told) <= calls:
        yield None, f"{counted(calls, 'call')} ended, and {counted(len(told), 'answer')} reached the mission"


def _two_answers(history: History) -> Iterator[Breach]:
    """At most two answers a call, each its own: the first, and then a better one by the deadline, which counts."""
    firsts, whereabouts = set[int | None](), CallPlaces()
    for event in history.run.events:
        whereabouts.take(event)
        if isinstance(event, schema.FirstAnswer):
            if event.waypoint in firsts:
                yield event, f"waypoint {event.waypoint} had a first answer before"
            firsts.add(event.waypoint)
        elif isinstance(event, schema.AnswerTaken) and not event.failed and whereabouts.answered is None:
            yield event, f"the answer of waypoint {event.waypoint} was taken before its call was over"
    last_s = history.within_s + SLACK_S
    counted_modes: dict[int | None, str] = {}
    for call in history.run.result.calls:
        counted_modes[call.waypoint] = call.key
        if call.first_s is not None and call.server is not None and call.delay_s > last_s:
            yield None, f"waypoint {call.waypoint} had a better answer {call.delay_s:.3f} s after its call"
    heard: dict[int, list[str]] = {}
    for event, report in _told(history):
        if report.raised:
            continue
        modes, mode = heard.setdefault(report.asked, []), report.answer["mode"]
        if mode in modes or "heavy" in modes:
            yield event, f"call {report.asked} was answered by {mode} after {modes}"
        if report != probing.expected(history.config.mission.program, mode, report.asked):
            why = f"call {report.asked} was answered by {report.answer}, which is another call's answer"
            yield event, why
        modes.append(mode)
    for number, modes in heard.items():
        if "heavy" in modes and counted_modes.get(number) == "light":
            yield None, f"call {number} had a better answer, and the first one counted"


def _answers_open(history: History) -> int:
    """How many answers a mission that ended early may have missed: the last one, or none; all where it acts later."""
    if _acts_later(history):
        return 0 if history.run.result.completed else len(history.run.result.calls)
    steps = list(history.logged(schema.CallStarted, schema.Call, schema.AnswerTaken))
    pending = any(isinstance(event, schema.CallStarted) for event in steps)
    return int(pending and isinstance(steps[-1], schema.Call) and not history.run.result.completed)


def _unbelievable(call: FlownCall) -> Iterator[Breach]:
    ended, alone = call.ended, [decision for decision in call.tried if not decision.raced]
    if len(alone) > 1 or (alone and alone[0] is not call.tried[0]):
        yield alone[-1], "a second server was tried for one call, and the drone's own service was not at it"
    if ended.server is None:
        return
    if (second := call.seconded) is not None and ended.server == second.second:
        if (late_s := ended.t - second.t - second.deadline_s) > SLACK_S:
            yield ended, f"was answered {late_s:.3f} s after the deadline of the second server"
        return
    answering = [decision for decision in call.tried if decision.server == ended.server]
    if not answering:
        yield ended, f"was answered by {ended.server}, where it was not sent"
        return
    hedged = call.hedged
    lates_s = [
        ended.t
        - decision.t
        - (hedged.deadline_s if hedged and decision is call.sent else deadline_of(decision))
        for decision in answering
    ]
    if min(lates_s) > SLACK_S:
        yield ended, f"was answered {min(lates_s):.3f} s after the deadline"


def truthful_errors(history: History) -> Iterator[Breach]:
    """The service's own exception for the calls that raise it, and no other; each was raised on the drone."""
    if _is_probing(history.config):
        yield from _raised_afar(history)
    for event, heard in _told(history):
        wanted = _expected(history.config, heard.asked)
        if heard.raised != wanted.raised:
            raised, instead = heard.raised or "nothing", wanted.raised or "nothing"
            yield event, f"call {heard.asked} raised {raised} instead of {instead}"
    if not history.may_be_cut_short and history.run.failure:
        yield None, f"the mission met an error: {history.run.failure}"


def _raised_afar(history: History) -> Iterator[Breach]:
    """Exceptions that a server reported and the mission received."""
    on_rows = history.flies_rows or _acts_later(history)
    servers: dict[int | None, str | None] = {}  # that answered the last call, or that of a waypoint
    latest = -1  # the last call that the mission heard of
    for event in history.run.events:
        if isinstance(event, schema.Call):
            servers[event.waypoint if on_rows else None] = event.server
        elif (heard := _heard(event)) is not None and (on_rows or heard.asked >= latest):
            latest = heard.asked  # an earlier call, whose answer waited for its act, is not the last
            if (server := servers.get(heard.asked if on_rows else None)) and heard.raised:
                why = (
                    f"the mission heard what {server} said was raised; the drone's own service was not asked"
                )
                yield event, why


def _told(history: History) -> Iterator[tuple[Event, probing.CallReport]]:
    for event in history.logged(schema.Notified) if _is_probing(history.config) else ():
        if (heard := _heard(event)) is not None:
            yield event, heard


def _heard(event: Event) -> probing.CallReport | None:
    if isinstance(event, schema.Notified) and isinstance(event.message, dict) and "asked" in event.message:
        return msgspec.convert(event.message, probing.CallReport)
    return None


def _is_probing(config: DroneConfig) -> bool:
    return config.mission.program.startswith(f"{probing.__name__}:")


def _expected(config: DroneConfig, number: int) -> probing.CallReport:
    mode: probing.Mode = "light" if config.mission.mode == "light" else "heavy"
    return probing.expected(config.mission.program, mode, number)


_AT_PLACE_M = 1.01  # a vehicle counts as arrived within 1 m, and figures are rounded
_ROUNDED_S = 0.1
_BRAKED_M = 1.5  # a vehicle that braked within this distance of a place counts as arrived there


def answers(history: History) -> Iterator[Breach]:
    """Judge by what the missions told their users that fly on before answers."""
    on_rows = history.flies_rows
    if not _acts_later(history):
        return
    places = [waypoint.position for waypoint in waypoints(history.config.mission)]
    done = list(_done(history))
    yield from _done_twice(done, history)
    if not history.position_jumps:
        near_m = _BRAKED_M if on_rows else _AT_PLACE_M
        for event, action in done:
            if ground_distance_m(event.at, places[action.done]) > near_m:
                yield event, f"action {action.done} was done beside its waypoint"
        if not on_rows:
            yield from _flown_back_too_far(history.run.events, places)
    yield from _put_off(history)
    yield from _lost_in_a_crash(history)
    for left in history.logged(schema.StayOrGo):
        if left.goes and left.waypoint == len(places) - 1:
            yield left, "it flew on from the last waypoint"
    if history.run.demand_map is not None:
        yield from _miscounted(history.run.demand_map, history)
    if history.run.result.completed:
        program, keys = history.config.mission.program, {}
        for call in history.run.result.calls:
            keys[call.waypoint] = call.key
        wanted = [n for n in range(len(places)) if demands_something(program, n, keys.get(n, ""))]
        acted = sorted(action.done for _, action in done)
        if acted != wanted:
            yield None, f"actions {wanted} were demanded, and {acted} done"


def _acts_later(history: History) -> bool:
    """Whether the mission makes one call at each waypoint, and may act on its answer later."""
    return history.config.mission.program.endswith((":look_later", "_on_the_move"))


def _miscounted(known: DemandMap, history: History) -> Iterator[Breach]:
    """A mission that ends between the count and its event has one more answer in its map."""
    taken = list(history.logged(schema.AnswerTaken))
    waiting, open_ = _waiting_for_acts(history.run.events)
    places = list(known.places())
    for what, count, logged in (
        ("answers", sum(place.answers for place in places), len(taken) + waiting),
        ("demands", sum(place.demands for place in places), sum(event.demanded for event in taken) + waiting),
    ):
        if not logged <= count <= logged + open_ + 1:
            yield None, f"the map of demands counts {count:g} {what}, and the log {logged}"


def _waiting_for_acts(events: Sequence[Event]) -> tuple[int, int]:
    """How many answers wait for acts that were put off, and are counted; and how many may have a better one first."""
    called, put_off = set[int | None](), dict[int | None, bool]()
    for event in events:
        match event:
            case schema.Call():
                called.add(event.waypoint)
            case schema.PutOff():
                put_off.setdefault(event.waypoint, event.waypoint in called)
            case schema.AnswerTaken():
                put_off.pop(event.waypoint, None)
    return sum(put_off.values()), len(put_off) - sum(put_off.values())


def _done_twice(done: Sequence[tuple[Event, ActionReport]], history: History) -> Iterator[Breach]:
    told = set[int]()
    for event, action in done:
        if action.done in told:
            yield event, f"action {action.done} was done twice"
        told.add(action.done)
    logged = [event.waypoint for event in history.logged(schema.Acted)]
    if len(set(logged)) != len(logged):
        yield None, f"the log has an action twice: {logged}"


def _done(history: History) -> Iterator[tuple[schema.Notified, ActionReport]]:
    for event in history.logged(schema.Notified):
        if isinstance(event.message, dict) and "done" in event.message:
            yield event, msgspec.convert(event.message, ActionReport)


def _put_off(history: History) -> Iterator[Breach]:
    """An act is put off where that costs less, and is in time."""
    within_s = history.config.policy.acts_within_s
    heard_s: dict[int | None, float] = {}
    for event in history.run.events:
        match event:
            case schema.Demanded(waypoint=waypoint):
                heard_s.setdefault(waypoint, event.t)
            case schema.PutOff(waypoint=waypoint, extra_s=extra_s, at_once_s=at_once_s):
                if extra_s > at_once_s:
                    yield event, f"action {waypoint} was put off, and cost less at once"
                if event.t + event.in_s > heard_s[waypoint] + within_s + _ROUNDED_S:
                    yield event, f"action {waypoint} was put off for longer than {within_s:g} s"


def _flown_back_too_far(events: Sequence[Event], places: Sequence[Position]) -> Iterator[Breach]:
    put_off = set[int | None]()
    for event in events:
        match event:
            case schema.PutOff(waypoint=waypoint):
                put_off.add(waypoint)
            case schema.TurnedBack(waypoint=int(waypoint), position=position) if waypoint not in put_off:
                leg_m = ground_distance_m(places[waypoint], places[waypoint + 1])
                if ground_distance_m(position, places[waypoint]) > leg_m + _AT_PLACE_M:
                    yield event, f"it flew back to waypoint {waypoint} from beyond the next one"


def _lost_in_a_crash(history: History) -> Iterator[Breach]:
    """After a crash at any event, a waypoint without its answer or action must be visited again."""
    kinds = schema.CallStarted, schema.SetOff, schema.AnswerTaken, schema.Notified, schema.Acted
    program = history.config.mission.program
    spots = range(len(waypoints(history.config.mission)))
    waited_for = {number for number in spots if is_waited_for(program, number)}
    for event, kept in history.crashes(*kinds):
        acted = {each.waypoint for each in kept if isinstance(each, schema.Acted)}
        taken = [each for each in kept if isinstance(each, schema.AnswerTaken)]
        settled = {answer.waypoint for answer in taken if not answer.demanded}
        done = waypoints_done(kept, history.config)
        for waypoint in done - acted - settled - waited_for:
            yield event, f"killed before this, waypoint {waypoint} would not be visited again"
        if history.flies_rows and len(history.config.services) == 1:  # of two, one may be due there
            for again in acted | settled:
                if again not in done:
                    why = f"killed before this, waypoint {again} would be visited again for nothing"
                    yield event, why
