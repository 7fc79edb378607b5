"""Promise 22: an instance of no use is replaced in time, and a service that keeps failing is left alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from upwash.config import FaultConfig
from upwash.core.admission.admission import AdmissionSettings
from upwash.core.admission.watchdog import CALL_LIMIT_S, FIRST_PAUSE_S, FORGOTTEN_S, LONGEST_PAUSE_S
from upwash.eventlog import schema
from upwash.lab.faults.promises.history import ROUNDING_S, SLACK_S, Breach, History
from upwash.lab.observer import Seen
from upwash.rpc.protocol import LEAVE

_LOOK_S, _DRAIN_S = 5.0, 2.0  # of a daemon
_FATAL = ("crash", "hung", "poisoned", "unstartable")  # for instances
_IDLE_S = AdmissionSettings().idle_stop_s


def replaced(history: History) -> Iterator[Breach]:
    """A hung instance ends in time, no other ends; starts that fail are rare, and drones respect the pauses."""
    yield from _asked_in_a_pause(history)
    flights_over_s = max((each.t for each in history.seen if each.event == "flight_over"), default=0.0)
    for server in history.config.servers:
        faults = [each for each in history.config.faults if each.target == server.name]
        of_server = [each for each in history.seen if each.server == server.name and each.service]
        for service in sorted({each.service for each in of_server}):
            facts = [each for each in of_server if each.service == service and each.t < flights_over_s]
            yield from _still_hung(facts, faults, end_s=flights_over_s)
            yield from _ended_without_cause(facts, faults)
            yield from _started_too_soon(facts)


def _still_hung(facts: Sequence[Seen], faults: Sequence[FaultConfig], *, end_s: float) -> Iterator[Breach]:
    """An instance that never answers a call is gone once the limit of a call, a look and a drain are over."""
    hung_s: float | None = None
    for fact in (*facts, Seen(event="over", t=end_s)):
        if hung_s is not None and fact.t > hung_s + CALL_LIMIT_S + _LOOK_S + _DRAIN_S + SLACK_S:
            yield fact, f"an instance that was hung at {hung_s:.3f} s is still not replaced"
            return
        if fact.event == "instance_ended":
            hung_s = None
        elif fact.event == "served" and hung_s is None and _kind(faults, fact.t) == "hung":
            hung_s = fact.t


def _ended_without_cause(facts: Sequence[Seen], faults: Sequence[FaultConfig]) -> Iterator[Breach]:
    used_s = 0.0
    for fact in facts:
        if fact.event in ("instance_started", "served"):
            used_s = fact.t
        elif fact.event == "instance_ended" and fact.t - used_s < _IDLE_S:
            if any(each.kind in _FATAL and each.from_s <= fact.t for each in faults):
                continue
            yield fact, f"an instance of {fact.service} ended, and nothing was wrong with it"


def _started_too_soon(facts: Sequence[Seen]) -> Iterator[Breach]:
    """Between starts that fail the service is left alone, each time for longer."""
    failed, ended_s, is_ready = 0, 0.0, False
    for fact in facts:
        match fact.event:
            case "instance_started":
                pause_s = min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** (failed - 1)) if failed else 0.0
                if fact.t < ended_s + pause_s - ROUNDING_S:
                    yield (
                        fact,
                        f"{fact.service} failed to start {failed} times in a row, last at {ended_s:.3f} s",
                    )
                if fact.t - ended_s - pause_s > FORGOTTEN_S - SLACK_S:
                    failed = 0
                is_ready = False
            case "admitted":  # an instance hears of drones once it is ready
                is_ready, failed = True, 0
            case "instance_ended" if not is_ready:
                failed, ended_s = failed + 1, fact.t


def _asked_in_a_pause(history: History) -> Iterator[Breach]:
    pauses = [each for each in history.run.events if isinstance(each, schema.LeftOut)]
    for fact in history.own("sent") if pauses else ():
        for pause in pauses:
            until_s = pause.t + pause.pause_s
            is_left_out = pause.t + ROUNDING_S < fact.t < until_s - ROUNDING_S
            if pause.server == fact.server and fact.path != LEAVE and is_left_out:
                yield fact, f"{fact.server} was left out until {until_s:.3f} s, as the server said"


def _kind(faults: Sequence[FaultConfig], now_s: float) -> str:
    """The kind of the first fault that is on."""
    return next((each.kind for each in faults if each.from_s <= now_s < each.to_s), "")
