"""What broke in a flight under faults: the promises of docs/promises.md over the logs that it left."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
from tests.system.faults.flight import LATENESS, RECORD, Record
from tests.system.faults.lateness import read_lateness, waits_of
from tests.system.faults.mission import Spotter, heard, numbers_at
from tests.system.faults.strikes import BACK_WITHIN_S, Strike

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import read_drone_config
from upwash.config.places import server_areas, waypoints
from upwash.config.truth import server_truth
from upwash.config.world import FaultConfig
from upwash.core.admission.admission import AdmissionSettings
from upwash.core.geo import Circle
from upwash.core.knowledge.servers import SELECTED, State
from upwash.eventlog import schema
from upwash.eventlog.kept import KeptEvents
from upwash.eventlog.log import decode
from upwash.eventlog.results import read_result
from upwash.eventlog.schema import Event
from upwash.lab.faults import promises
from upwash.lab.faults.history import calls_of
from upwash.lab.faults.promises import Promise
from upwash.lab.faults.selection_promises import spells_of
from upwash.lab.run import Run

_OF_CALLS = (Promise.BOUNDED_CALLS, Promise.ONE_ANSWER, Promise.TRUTHFUL_ERRORS)
_OF_SERVERS = (Promise.ONE_SELECTION, Promise.RANGE, Promise.RESPECT, Promise.RECOVERY)
_EDGE_M = 1.0  # nearer to the border of a range, no call has to go there
_SLOWEST_LOOK_S = 0.1  # of a time of day that two processes read


@dataclass(frozen=True)
class Flown:
    """One drone's flight, by its log; the times of its events are by the time of day."""

    config: DroneConfig
    events: list[Event]
    began_s: float

    @property
    def parts(self) -> list[list[Event]]:
        """The events of each program that flew it, of which all but the last were killed."""
        found: list[list[Event]] = []
        for event in self.events:
            if isinstance(event, (schema.LogOpened, schema.LogResumed)):
                found.append([])
            found[-1].append(event)
        return found


@dataclass(frozen=True)
class Return:
    """How long after a black-out a call was answered by the server again; None where none was made to tell."""

    strike: Strike
    after_s: float | None


@dataclass(frozen=True)
class Verdict:
    """What broke, and what was measured."""

    record: Record
    broken: list[str]
    returns: list[Return]
    calls: int
    remote_calls: int
    longest_s: tuple[float, float]  # the longest call, and its bound
    spare_s: float  # the least that a call left of its bound


class Returns(msgspec.Struct, frozen=True, kw_only=True):
    """Black-outs of one length: how many, and after how long calls were back at the server."""

    lasted_s: float
    times: int
    soonest_s: float
    latest_s: float


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """What many flights came to; `strikes` counts faults by what they did to what."""

    flights: int
    broken: int
    calls: int
    remote_calls: int
    strikes: dict[str, int]
    longest_s: tuple[float, float]
    spare_s: float
    returns: list[Returns]


def summed_up(verdicts: Sequence[Verdict]) -> Figures:
    """The figures of the flights."""
    strikes = Counter(
        f"{strike.what} {strike.target}" for verdict in verdicts for strike in verdict.record.strikes
    )
    by_length: dict[float, list[float]] = {}
    for each in (each for verdict in verdicts for each in verdict.returns):
        if each.after_s is not None:
            by_length.setdefault(round(each.strike.to_s - each.strike.from_s), []).append(each.after_s)
    return Figures(
        flights=len(verdicts),
        broken=sum(bool(verdict.broken) for verdict in verdicts),
        calls=sum(verdict.calls for verdict in verdicts),
        remote_calls=sum(verdict.remote_calls for verdict in verdicts),
        strikes=dict(sorted(strikes.items())),
        longest_s=max(verdict.longest_s for verdict in verdicts),
        spare_s=min(verdict.spare_s for verdict in verdicts),
        returns=[
            Returns(lasted_s=lasted_s, times=len(after_s), soonest_s=min(after_s), latest_s=max(after_s))
            for lasted_s, after_s in sorted(by_length.items())
        ],
    )


def judge(folder: Path) -> Verdict:
    """Reads what a flight left in the folder; what is broken says which promise, and by what."""
    record = msgspec.json.decode((folder / RECORD).read_bytes(), type=Record)
    broken = [f"promise 1: {name} ended with {code}" for name, code in record.exit_codes.items() if code != 0]
    flown = []
    for name in record.exit_codes:
        try:
            flown.append(_read(folder, name))
        except (ValueError, OSError) as error:
            broken.append(f"promise 10: the log of {name}: {error}")
    if len(flown) < len(record.exit_codes):  # nothing can be said of the rest
        return Verdict(record, broken, [], 0, 0, (0.0, 0.0), math.inf)
    struck, late_s = flown[0], read_lateness(folder / LATENESS)
    black_outs = [each for each in record.strikes if each.is_black_out]
    bounds_s, places = [], []
    for each in flown:
        waited_s = read_lateness(waits_of(folder / f"{each.config.name}.jsonl"))
        stops = _stops(each, record.strikes if each is struck else (), [*late_s, *waited_s])
        broken += [f"{each.config.name}: {why}" for why in _broken(each, stops, record.strikes)]
        for call in (call for part in each.parts for call in calls_of(_without(part, stops))):
            bounds_s.append((call.ended.delay_s, call.bound_s))
            places.append(call.ended.server)
    for strike in black_outs:
        broken += [f"{struck.config.name}: {why}" for why in _not_returned(struck, strike, record.strikes)]
    return Verdict(
        record=record,
        broken=[*broken, *_admission(record, flown)],
        returns=[Return(out, _returned_s(struck, out)) for out in black_outs],
        calls=len(places),
        remote_calls=len(places) - places.count(None),
        longest_s=max(bounds_s),
        spare_s=min(bound_s - delay_s for delay_s, bound_s in bounds_s),
    )


def _read(folder: Path, name: str) -> Flown:
    """Every line has to be whole, also those that a killed program wrote."""
    lines = (folder / f"{name}.jsonl").read_bytes().split(b"\n")
    if lines.pop():
        raise ValueError("its last line is torn")
    events = [decode(line) for line in lines]
    times = [event.t for event in events]
    if times != sorted(times):
        raise ValueError("its times go back")
    opened = events[0]
    if not isinstance(opened, schema.LogOpened):
        raise ValueError("it does not begin with the time of day")  # noqa: TRY004 - as of the rest of a file
    began_s = opened.time.timestamp()
    return Flown(read_drone_config(folder / f"{name}.toml"), events, began_s)


# --- promises of one flight ---------------------------------------------------------------------------------


def _broken(flown: Flown, stops: Sequence[tuple[float, float]], strikes: Sequence[Strike]) -> Iterator[str]:
    yield from _unfinished(flown)
    yield from _misheard(flown)
    for part in flown.parts:
        yield from _checked(_history(flown, part, strikes), _OF_SERVERS)
        yield from _checked(_history(flown, _without(part, stops), ()), _OF_CALLS)


def _history(flown: Flown, events: list[Event], strikes: Iterable[Strike]) -> promises.History:
    """What the promises are judged by, which know of servers' faults by the scenario."""
    faults = tuple(
        FaultConfig(
            kind="off",
            target=f"link:{strike.server}" if strike.target == "link" else strike.server,
            from_s=max(0.0, strike.from_s - flown.began_s),
            to_s=max(0.0, strike.from_s - flown.began_s, strike.to_s - flown.began_s),
        )
        for strike in strikes
        if strike.target in ("link", "daemon", "instance")
    )
    config = msgspec.structs.replace(flown.config, faults=faults)
    return promises.History(config, Run(KeptEvents(events), read_result(events), []))


def _checked(history: promises.History, checks: Iterable[Promise]) -> Iterator[str]:
    for promise in checks:
        for event, why in promises.CHECKS[promise](history):
            yield f"{promise}: {why}: {event}"


def _unfinished(flown: Flown) -> Iterator[str]:
    names = [event.kind for event in flown.events]
    if "mission_completed" not in names:
        yield "promise 1: the mission was not completed"
    if "offloading_failed" in names:
        yield "promise 1: offloading ended for the rest of the flight"
    arrived = {event.waypoint for event in flown.events if isinstance(event, schema.Arrived)}
    if missing := {waypoint.index for waypoint in waypoints(flown.config.mission)} - arrived:
        yield f"promise 1: never arrived at {sorted(missing)}"


def _misheard(flown: Flown) -> Iterator[str]:
    """Each call's own answer, once, but for those of a waypoint at which the program was killed."""
    spotter = Spotter()
    told = [
        [
            msgspec.convert(event.message, dict[str, object])
            for event in part
            if isinstance(event, schema.Notified)
        ]
        for part in flown.parts
    ]
    for message in (each for part in told for each in part):
        wanted = msgspec.to_builtins(heard(spotter, msgspec.convert(message["asked"], int)))
        if message != wanted:
            yield f"promises 3 and 4: heard {message} instead of {wanted}"
    for part in told:
        asked = [msgspec.convert(message["asked"], int) for message in part]
        if asked != sorted(set(asked)):
            yield f"promise 3: answered out of turn: {asked}"
    wanted_numbers = {
        number for waypoint in waypoints(flown.config.mission) for number in numbers_at(waypoint.index)
    }
    if missing := wanted_numbers - {message["asked"] for part in told for message in part}:
        yield f"promise 1: no answer to {sorted(missing)}"


# --- a program that could keep no time ----------------------------------------------------------------------


def _stops(
    flown: Flown, strikes: Iterable[Strike], late_s: Iterable[tuple[float, float]]
) -> list[tuple[float, float]]:
    """When the drone's own program stood still, stopped or for want of a processor: no bound holds then."""
    frozen_s = [
        (strike.from_s, strike.to_s)
        for strike in strikes
        if (strike.what, strike.target) == ("freeze", "drone")
    ]
    stops: list[tuple[float, float]] = []
    for from_s, to_s in sorted([*frozen_s, *late_s]):
        begin_s = max(from_s - flown.began_s, stops[-1][1] if stops else 0.0)
        if to_s - flown.began_s > begin_s:
            stops.append((begin_s, to_s - flown.began_s))
    return stops


def _without(events: list[Event], stops: Sequence[tuple[float, float]]) -> list[Event]:
    """The events as they would be if time had stood still too."""
    return [_shifted(event, stops) for event in events]


def _shifted(event: Event, stops: Sequence[tuple[float, float]]) -> Event:
    def before(t_s: float) -> float:
        return sum(max(0.0, min(t_s, to_s) - from_s) for from_s, to_s in stops)

    shifted = {"t": event.t - before(event.t)}
    if isinstance(event, schema.Call):
        shifted["delay_s"] = event.delay_s - (before(event.t) - before(event.t - event.delay_s))
    return msgspec.structs.replace(event, **shifted)


# --- links that are there again -----------------------------------------------------------------------------


def _decided_and_ended(flown: Flown) -> Iterator[tuple[float, schema.Decided, schema.Call]]:
    """When each call was first decided on, by the time of day, that decision, and the call."""
    for part in flown.parts:
        for call in calls_of(part):
            first = call.decisions[0]
            yield flown.began_s + first.t, first, call.ended


def _answered_by(call: schema.Call, server: str) -> bool:
    """Whether the server gave the answer; one that a service raised there is made sure of on the drone."""
    return call.server == server or call.remote_fault == "confirmed"


def _returned_s(flown: Flown, strike: Strike) -> float | None:
    for decided_s, _, ended in _decided_and_ended(flown):
        if decided_s >= strike.to_s and _answered_by(ended, strike.server):
            return decided_s - strike.to_s
    return None


def _not_returned(flown: Flown, strike: Strike, strikes: Iterable[Strike]) -> Iterator[str]:
    """Calls in range that the server did not answer although its link had been there again for long enough."""
    area = server_areas(flown.config)[strike.server]
    assert isinstance(area, Circle)
    inner = Circle(area.centre, area.radius_m - _EDGE_M)
    until_s = min((each.from_s for each in strikes if each.from_s > strike.to_s), default=float("inf"))
    back_s = max(strike.back_s, _trusted_s(flown, strike) + BACK_WITHIN_S)
    for decided_s, decided, ended in _decided_and_ended(flown):
        if not back_s <= decided_s < until_s - ended.delay_s:
            continue
        if inner.contains(decided.position) and not _answered_by(ended, strike.server):
            yield (
                f"{decided_s - strike.to_s:.2f} s after the end of a black-out of "
                f"{strike.to_s - strike.from_s:.0f} s a call ran at {ended.place}: {ended.decision}"
            )


def _trusted_s(flown: Flown, strike: Strike) -> float:
    """From when on the server may be asked again, which failed more than once lately."""
    spells = (
        spell for part in flown.parts for spell in spells_of(_history(flown, part, ())).get(strike.server, [])
    )
    probed_s = [
        flown.began_s + each.probed_s for each in spells if flown.began_s + each.from_s < strike.back_s
    ]
    return max(probed_s, default=-math.inf)


# --- promise 11 ---------------------------------------------------------------------------------------------


def _admission(record: Record, flown: Sequence[Flown]) -> Iterator[str]:
    for name in record.daemons_ended:
        yield f"promise 11: the daemon of {name} ended"
    for name, most in record.most_instances.items():
        if most > 1:
            yield f"promise 11: {name} ran {most} instances of one service"
    for server in flown[0].config.servers:
        if server_truth(server, flown[0].config.services).slots == 1:
            yield from _served_two(server.name, record, flown)


def _served_two(server: str, record: Record, flown: Sequence[Flown]) -> Iterator[str]:
    """Between answers to two drones, the first has left, or its lease is over, or the daemon was another one.

    A drone that leaves still hears the answer to the call that was under way, and holds no slot by that.
    """
    facts = sorted(
        (each.began_s + event.t, each.config.name, _what(event))
        for each in flown
        for event in each.events
        if server == getattr(event, "server", None)
    )
    forgot_s = [
        strike.from_s for strike in record.strikes if (strike.server, strike.target) == (server, "daemon")
    ]
    holder, last_s = "", 0.0
    gone: set[str] = set()
    for at_s, drone, what in facts:
        if what == "ready":
            gone.discard(drone)
        elif what == "left":
            gone.add(drone)
            holder = "" if drone == holder else holder
        elif what == "answered" and drone not in gone:
            still_held = at_s - last_s < AdmissionSettings().lease_s - _SLOWEST_LOOK_S
            forgotten = any(last_s - _SLOWEST_LOOK_S <= each <= at_s for each in forgot_s)
            if holder not in ("", drone) and still_held and not forgotten:
                yield f"promise 11: {server} answered {drone} {at_s - last_s:.1f} s after {holder}, in its one slot"
            holder, last_s = drone, at_s


def _what(event: Event) -> str:
    if isinstance(event, schema.Call):
        return "answered"
    if not isinstance(event, schema.ServerStep):
        return ""
    if event.after is State.READY:
        return "ready"
    return "" if event.after in SELECTED else "left"
