"""One run as reports tell it, read from its event log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import msgspec

from upwash import event_log
from upwash.core.geo import Circle, GeoPosition, Position
from upwash.core.servers import Event, State
from upwash.errors import UsageError
from upwash.reasons import explained_calls, told
from upwash.results import CallResult, RunResult, last_run, read_result

_STEPS = frozenset(Event)


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """What the drone set out to do, and where it believed servers to be in range; no home where it needed none."""

    home: GeoPosition | None = None
    waypoints_m: list[tuple[float, float]] = []
    ranges: dict[str, Circle] = {}
    paced: bool = False


@dataclass(frozen=True, slots=True)
class Call:
    """One call, why it ran where it ran, in sentences, and where the drone was then."""

    result: CallResult
    reasons: Sequence[str]
    position: Position | None
    wait: str
    fell_back: bool


@dataclass(frozen=True, slots=True)
class Stretch:
    """A time that a server spent in one state, in seconds of the mission, and why it came into it."""

    state: State
    from_s: float
    to_s: float
    why: str


@dataclass(frozen=True, slots=True)
class Fix:
    """Where the drone was at a second of the mission."""

    at_s: float
    position: Position


@dataclass(frozen=True, slots=True)
class Record:
    """One run; `servers` are those of the plan and of the calls, in the order of their names.

    `opened` is the time of day at second 0 of the event log, None for a simulated one; `began_s` is the second of the
    log at which the mission began.
    """

    name: str
    opened: datetime | None
    began_s: float
    events: Sequence[Mapping[str, Any]]
    result: RunResult
    plan: Plan
    calls: Sequence[Call]
    track: Sequence[Fix]
    stretches: Mapping[str, Sequence[Stretch]]

    @property
    def servers(self) -> list[str]:
        """The servers that the run knows of, by name."""
        return sorted({*self.plan.ranges, *self.stretches, *self.result.totals.remote})

    @property
    def saved_s(self) -> float | None:
        """What offloading saved against the local delays measured; None where they are not known."""
        local_only_s = self.result.local_only_time_s()
        if local_only_s is None or not self.result.completed:
            return None
        return local_only_s - self.result.mission_time_s


def read_records(logs: Sequence[Path]) -> list[Record]:
    """The last run of each log, named after its file; raises UsageError for what is no log of a mission."""
    return [_read_record(log, name) for log, name in zip(logs, names_of(logs), strict=True)]


def names_of(logs: Sequence[Path]) -> list[str]:
    """The shortest names that tell the logs apart: those of runs/TIME/events.jsonl are their folders'."""
    short = [log.resolve().parent.name if log.stem == "events" else log.stem for log in logs]
    return [name if short.count(name) == 1 else str(log) for name, log in zip(short, logs, strict=True)]


def _read_record(log: Path, name: str) -> Record:
    events = _mission(event_log.read(log))
    began_s = next((event["t"] for event in events if event["event"] == "mission_started"), None)
    if began_s is None:
        raise UsageError(f"{log} has no mission: it ended before one began")
    try:
        result = read_result(events)
        plan = msgspec.convert(next((event for event in events if event["event"] == "planned"), {}), Plan)
        return Record(
            name=name,
            opened=_opened(events),
            began_s=began_s,
            events=events,
            result=result,
            plan=plan,
            calls=list(_calls(events, result.calls)),
            track=list(_track(events, began_s)),
            stretches=_stretches(events, began_s, plan),
        )
    except (KeyError, TypeError, ValueError) as error:  # msgspec's ValidationError is a ValueError
        raise UsageError(f"{log} is not an event log that this version reads: {error!r}") from error


def _opened(events: Sequence[Mapping[str, Any]]) -> datetime | None:
    first = events[0]
    return datetime.fromisoformat(first["time"]) if first["event"] == "log_opened" else None


def _mission(events: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The last run's events until the mission was completed."""
    mission: list[Mapping[str, Any]] = []
    for event in last_run(events):
        mission.append(event)
        if event["event"] == "mission_completed":
            break
    return mission


def _calls(events: Sequence[Mapping[str, Any]], results: Sequence[CallResult]) -> Iterator[Call]:
    for call, result in zip(explained_calls(events), results, strict=True):
        position = call.decisions[0]["position"] if call.decisions else None
        yield Call(
            result=result,
            reasons=list(told(call))[1:],
            position=msgspec.convert(position, Position | None),
            wait=call.outcome["wait"],
            fell_back=call.outcome["fell_back"],
        )


def _track(events: Sequence[Mapping[str, Any]], began_s: float) -> Iterator[Fix]:
    """Every place that an event tells: simulated drones report none by the second."""
    last: Position | None = None
    for event in events:
        here = place_of(event, last) if event["t"] >= began_s else None
        if here is not None and here != last:
            yield Fix(event["t"] - began_s, here)
        last = here or last


def place_of(event: Mapping[str, Any], last: Position | None) -> Position | None:
    """Where an event tells that the drone was; as high as `last` where it tells a place without an altitude."""
    place = event if event["event"] in {"position", "arrived"} else event.get("position")
    if place is None:
        return None
    altitude_m = place.get("altitude_m", last.altitude_m if last else 0.0)
    return Position(float(place["east_m"]), float(place["north_m"]), float(altitude_m))


def _stretches(
    events: Sequence[Mapping[str, Any]], began_s: float, plan: Plan
) -> Mapping[str, Sequence[Stretch]]:
    now: dict[str, tuple[State, float, str]] = dict.fromkeys(plan.ranges, (State.AVL, 0.0, ""))
    stretches: dict[str, list[Stretch]] = {name: [] for name in plan.ranges}

    def end(server: str, at_s: float) -> None:
        state, since_s, why = now[server]
        if at_s > since_s:
            stretches[server].append(Stretch(state, since_s, at_s, why))

    for event in events:
        if event["event"] == "log_resumed":  # a program that begins anew knows of no server's state
            for server in now:
                end(server, event["t"] - began_s)
                now[server] = (State.AVL, event["t"] - began_s, "taken up again")
        elif event["event"] in _STEPS:
            server, at_s = event["server"], max(0.0, event["t"] - began_s)
            if server not in now:
                now[server], stretches[server] = (State(event["before"]), 0.0, ""), []
            end(server, at_s)
            now[server] = (State(event["after"]), at_s, event["why"])
    for server in now:
        end(server, events[-1]["t"] - began_s)
    return dict(sorted(stretches.items()))
