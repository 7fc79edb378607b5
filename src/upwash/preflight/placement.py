"""Where servers help most: the places of all of them together, by the predicted mission time.

one more    the places of one server less, and the best of STEPS by STEPS middles of equal parts of the field
or covering places whose ranges together have the most waypoints
moved       then one server at a time to another middle, while that helps
pushed      and by half a part, by a quarter, and so on down to FINEST_M
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import reduce
from operator import or_
from pathlib import Path
from statistics import fmean

from msgspec import Struct

from upwash.config.drone import DroneConfig
from upwash.config.places import waypoints
from upwash.config.reading import Document
from upwash.core.geo import Position, ground_distance_m
from upwash.errors import UsageError
from upwash.lab.campaigns.campaign import Fly
from upwash.preflight.prediction import changed, predict

STEPS = 6  # middles along each side of the field
FINEST_M = 5.0  # a box is not put down more exactly
_MOST_LINES = 24  # of the grid for comparing ranges, each way
_MOST_STARTS = 8

Places = tuple[Position | None, ...]  # None for a server that is not there
TimesOf = Callable[
    [Sequence[Places]], Sequence[float]
]  # the mission times with servers there, infinity without an end


class SuggestedPlace(Struct, frozen=True, kw_only=True):
    """A place for a server, and how much longer the mission would take without this server."""

    server: str
    east_m: float
    north_m: float
    gain_s: float


class Placement(Struct, frozen=True, kw_only=True):
    """The best places of servers together, and the mission times with all of them and with the last one less.

    There are fewer places than servers if one more gains nothing.
    """

    places: tuple[SuggestedPlace, ...]
    mission_time_s: float
    one_less_s: float


def place(
    document: Document,
    config: DroneConfig,
    file: Path,
    *,
    more: int,
    fly: Fly,
    flown: Callable[[int], None] = lambda _: None,
) -> tuple[Placement, Document]:
    """Finds places for that many more servers, or with 0 for those of the file; also returns the document with them.

    Further servers are like the first of the file. A trial is one mission without noise. Raises UsageError without a
    server in the file, and if no mission is completed.
    """
    if not config.servers:
        raise UsageError(
            "nothing can be placed without a [[server]] in the file: further servers are like the first"
        )
    servers = _more_servers(document, config, more) if more else _movable(document["server"])
    document = {**document, "server": document["server"] if more else []}
    silent = changed(document)
    silent.pop("noise", None)  # which would favour a lucky place
    for service in silent["service"]:
        service.pop("deadline", None)  # which refuses most places
    failures: list[str] = []

    def times_s(trials: Sequence[Places]) -> list[float]:
        documents = {
            str(number): _with_servers(silent, servers, places) for number, places in enumerate(trials)
        }
        found = predict(documents, file, seeds=1, fly=fly, flown=flown)
        failures.extend(failure for one in found for failure in one.failures)
        return [math.inf if one.mission_time_s is None else one.mission_time_s for one in found]

    trials = Trials(times_s)
    way = [waypoint.position for waypoint in waypoints(config.mission)]
    ranges_m = [server.get("range_m", 0.0) for server in servers]
    best = best_places(way, ranges_m, trials)
    time_s = trials.time_s(best)
    if math.isinf(time_s):
        raise UsageError(f"no place can be compared: no mission is completed: {failures[0]}")
    places = tuple(
        SuggestedPlace(
            server=server["name"],
            east_m=at.east_m,
            north_m=at.north_m,
            gain_s=trials.time_s((*best[:number], None, *best[number + 1 :])) - time_s,
        )
        for number, (server, at) in enumerate(zip(servers, best, strict=False))
        if at is not None
    )
    less_s = trials.time_s(best_places(way, ranges_m[: max(0, len(best) - 1)], trials))
    return (
        Placement(places=places, mission_time_s=time_s, one_less_s=less_s),
        _with_servers(document, servers, best),
    )


class Trials:
    """The mission times of servers at places, each flown once."""

    def __init__(self, times_s: TimesOf) -> None:
        self._times_s = times_s
        self._known: dict[Places, float] = {}

    def time_s(self, places: Places) -> float:
        """The mission time with servers there."""
        return self._all([places])[0]

    def best(self, trials: Iterable[Places], than: Places) -> Places:
        """The places with the shortest mission; `than` if none is shorter."""
        tried = [than, *trials]
        times_s = self._all(tried)
        return tried[times_s.index(min(times_s))]

    def _all(self, trials: Sequence[Places]) -> list[float]:
        new = list(dict.fromkeys(places for places in trials if places not in self._known))
        if new:
            self._known.update(zip(new, self._times_s(new), strict=True))
        return [self._known[places] for places in trials]


def best_places(way: Sequence[Position], ranges_m: Sequence[float], trials: Trials) -> Places:
    """The best places found for servers with these ranges; fewer if one more gains nothing."""
    field = candidates(way)
    best: Places = ()
    for count in range(1, len(ranges_m) + 1):
        starts = [*((*best, at) for at in field), *covering(way, ranges_m[:count])]
        start = trials.best(starts, than=best)
        found = _pushed(_improved(start, lambda _: field, trials), way, trials)
        if len(found) < count:
            break
        best = found
    return best


def candidates(places: Sequence[Position]) -> list[Position]:
    """The middles of equal parts of the field that the places span."""
    return [
        Position(east_m, north_m)
        for east_m, north_m in itertools.product(
            sorted(set(_middles([place.east_m for place in places]))),
            sorted(set(_middles([place.north_m for place in places]))),
        )
    ]


def _middles(values_m: Sequence[float]) -> Iterator[float]:
    low_m, high_m = min(values_m), max(values_m)
    for step in range(STEPS):
        yield low_m + (step + 0.5) * (high_m - low_m) / STEPS


def covering(way: Sequence[Position], ranges_m: Sequence[float]) -> list[Places]:
    """Some places, at most eight, whose ranges together have the most of the way's places; none without ranges."""
    if not all(ranges_m):
        return []
    norths_m = _lines([at.north_m for at in way])
    grid = [Position(east_m, north_m) for east_m in _lines([at.east_m for at in way]) for north_m in norths_m]
    masks = {range_m: [_within(at, range_m, way) for at in grid] for range_m in set(ranges_m)}
    by_server = [masks[range_m] for range_m in ranges_m]
    ends = {_exchanged(start, by_server) for start in range(0, len(grid), max(1, len(grid) // STEPS**2))}
    counts = {end: _joined(end, by_server).bit_count() for end in ends}
    best = sorted(end for end in ends if counts[end] == max(counts.values()))
    return [tuple(grid[number] for number in end) for end in best[:_MOST_STARTS]]


def _lines(values_m: Sequence[float]) -> Sequence[float]:
    """The lines of a grid: through the values and half-way between two of them, or as many as are compared."""
    values_m = sorted(set(values_m))
    lines = sorted([*values_m, *(fmean(two) for two in itertools.pairwise(values_m))])
    if len(lines) <= _MOST_LINES:
        return lines
    step_m = (lines[-1] - lines[0]) / (_MOST_LINES - 1)
    return [lines[0] + step_m * number for number in range(_MOST_LINES)]


def _within(centre: Position, range_m: float, way: Sequence[Position]) -> int:
    """The way's places in the range, as bits."""
    return sum(1 << number for number, at in enumerate(way) if ground_distance_m(at, centre) <= range_m)


def _joined(places: Sequence[int], masks: Sequence[Sequence[int]]) -> int:
    return reduce(or_, (mask[place] for place, mask in zip(places, masks, strict=True)), 0)


def _exchanged(start: int, masks: Sequence[Sequence[int]]) -> tuple[int, ...]:
    """Places on the grid, the first of them near `start`, from where no move of one covers more."""
    places = [start]
    for number, mask in enumerate(masks[1:], start=1):
        joined = _joined(places, masks[:number])
        places.append(_most(mask, joined))
    while True:
        former = tuple(places)
        for number, mask in enumerate(masks):
            others = _joined(places[:number] + places[number + 1 :], [*masks[:number], *masks[number + 1 :]])
            best = _most(mask, others)
            if (others | mask[best]).bit_count() > (others | mask[places[number]]).bit_count():
                places[number] = best
        if tuple(places) == former:
            return former


def _most(mask: Sequence[int], joined: int) -> int:
    """The place that has the most besides what is joined."""
    return max(range(len(mask)), key=lambda place: (joined | mask[place]).bit_count())


def _pushed(places: Places, way: Sequence[Position], trials: Trials) -> Places:
    easts_m, norths_m = [at.east_m for at in way], [at.north_m for at in way]
    step_m = max(max(easts_m) - min(easts_m), max(norths_m) - min(norths_m)) / STEPS / 2
    while step_m >= FINEST_M:
        places = _improved(places, lambda at, step_m=step_m: _around(at, step_m), trials)  # type: ignore[misc]
        step_m /= 2
    return places


def _around(at: Position, step_m: float) -> list[Position]:
    steps = itertools.product((-step_m, 0.0, step_m), repeat=2)
    return [Position(at.east_m + east_m, at.north_m + north_m) for east_m, north_m in steps]


def _improved(places: Places, others: Callable[[Position], Sequence[Position]], trials: Trials) -> Places:
    """The places after moves of one server at a time, each to the best of the other places, while one helps."""
    while True:
        former = places
        for number, at in enumerate(places):
            assert at is not None  # noqa: S101 - all are placed
            moved = [(*places[:number], other, *places[number + 1 :]) for other in others(at)]
            places = trials.best(moved, than=places)
        if places == former:
            return places


def _more_servers(document: Document, config: DroneConfig, more: int) -> Sequence[Document]:
    first = {key: value for key, value in document["server"][0].items() if key not in ("address", "network")}
    return _movable([{**first, "name": name} for name in itertools.islice(_free_names(config), more)])


def _movable(servers: Sequence[Document]) -> Sequence[Document]:
    degrees = ("latitude_deg", "longitude_deg")
    return [{key: value for key, value in server.items() if key not in degrees} for server in servers]


def _with_servers(document: Document, servers: Sequence[Document], places: Places) -> Document:
    other = copy.deepcopy(document)
    other["server"] += [
        {**copy.deepcopy(server), "east_m": at.east_m, "north_m": at.north_m}
        for server, at in zip(servers, places, strict=False)
        if at is not None
    ]
    return other


def _free_names(config: DroneConfig) -> Iterator[str]:
    taken = {server.name for server in config.servers}
    return (name for name in (f"new{number}" for number in itertools.count(1)) if name not in taken)
