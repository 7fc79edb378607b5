"""A flight as traces for simulations: the files that `vehicle.track_csv` and its like read."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence

from upwash.core.geo import Position, part_way
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.report.exports import as_csv
from upwash.report.record import Record
from upwash.report.story import place_of

_UNSAFE = re.compile(r"[^\w.-]")  # in a file's name: a log may be a stranger's
_TIMES = "-times.csv"
_AT_PLACE = (
    schema.Armed, schema.TookOff, schema.Holding, schema.Returning, schema.Landing, schema.Landed, schema.Disarmed,
)  # fmt: skip
_APART_S = 10.0  # of two rows of a track, at most: what a log does not tell is flown straight


def traces_of(record: Record) -> dict[str, str]:
    """By name, the files that can be made of the log; times count from the take-off."""
    calls: dict[str, list[Sequence[object]]] = {}
    for event in record.events:
        if isinstance(event, schema.Call) and event.server is not None and not event.onboard_s:
            took_s = event.delay_s - event.waited_s - (event.queued_s or 0.0)
            calls.setdefault(event.server, []).append((event.operation, _number(took_s)))
    found: dict[str, tuple[str, Sequence[Sequence[object]]]] = {
        _UNSAFE.sub("_", server) + _TIMES: ("operation,seconds", calls[server])
        for server in record.servers
        if server in calls
    }
    since_s = next((event.t for event in record.events if isinstance(event, schema.TakingOff)), None)
    if since_s is not None:
        found["track.csv"] = "t_s,east_m,north_m,altitude_m", list(_track(record.events, since_s))
        for name, columns, value in (
            ("wind.csv", "t_s,east_m_s,north_m_s", _wind),
            ("battery.csv", "t_s,percent", _charge),
        ):
            if rows := list(_changes(record.events, since_s, value)):
                found[name] = columns, rows
    return {name: as_csv([columns.split(","), *rows]) for name, (columns, rows) in found.items()}


def settings_of(files: Iterable[str]) -> Iterator[str]:
    """The lines of a scenario that name the files."""
    yield "[vehicle]"
    yield from (f'{name.removesuffix(".csv")}_csv = "{name}"' for name in files if not name.endswith(_TIMES))
    for name in files:
        if name.endswith(_TIMES):
            yield f"\n[server.truth]  # of {name.removesuffix(_TIMES)}, without bandwidth_bit_s: with the way"
            yield f'service_csv = "{name}"'


def _track(events: Iterable[Event], since_s: float) -> Iterator[Sequence[object]]:
    """A row for each place and time that the log tells, from the ground to the ground."""
    told: tuple[type[Event], ...] = (schema.Arrived, *_AT_PLACE)
    if any(isinstance(event, schema.PositionReport) for event in events):
        told = (schema.PositionReport,)
    here: Position | None = None
    at_s, begun, rests = 0.0, False, True
    for event in events:
        place = place_of(event, here) if isinstance(event, told) else None
        if event.t < since_s:
            here = place or here
            continue
        now_s = event.t - since_s
        if place is not None and not begun:
            begun = True
            yield _row(0.0, (here or place).at_altitude(0.0))
        leaves = here if isinstance(event, schema.SetOff) and rests else None
        if isinstance(event, schema.Arrived):
            rests = not event.passing
        if (place := place or leaves) is None or now_s <= at_s:
            continue
        if here is not None:
            steps = int((now_s - at_s) / _APART_S)
            for step in range(1, steps + 1):
                share = step / (steps + 1)
                yield _row(at_s + share * (now_s - at_s), part_way(here, place, share))
        yield _row(now_s, place)
        here, at_s = place, now_s


def _row(at_s: float, place: Position) -> Sequence[object]:
    return tuple(map(_number, (at_s, place.east_m, place.north_m, place.altitude_m)))


def _wind(event: Event) -> tuple[float, ...] | None:
    if isinstance(event, schema.PositionReport) and event.wind_east_m_s is not None:
        return event.wind_east_m_s, event.wind_north_m_s or 0.0
    return None


def _charge(event: Event) -> tuple[float, ...] | None:
    percent = (
        event.battery_percent
        if isinstance(event, schema.PositionReport)
        else event.left_percent
        if isinstance(event, schema.Energy)
        else None
    )
    return None if percent is None else (min(100.0, max(0.0, percent)),)


def _changes(
    events: Iterable[Event], since_s: float, value: Callable[[Event], tuple[float, ...] | None]
) -> Iterator[Sequence[object]]:
    """What was reported at the take-off, and after each change."""
    last: tuple[float, ...] | None = None
    at_s = -1.0
    for event in events:
        if (now := value(event)) is None:
            continue
        if event.t < since_s:
            last = now
            continue
        if at_s < 0:
            yield tuple(map(_number, (0.0, *(last or now))))
            at_s = 0.0
        if now != last and event.t - since_s > at_s:
            at_s = event.t - since_s
            yield tuple(map(_number, (at_s, *now)))
        last = now


def _number(value: float) -> str:
    return f"{round(value, 3):g}" if abs(value) < 1000 else f"{value:.3f}"
