"""Where servers help most: the places of all of them together, by the predicted mission time.

one more    the places of one server less, and the best of STEPS by STEPS middles of equal parts of the field
or spread   the middles of as many equal parts of the way
moved       one server at a time to another middle, while that helps
pushed      one server at a time by half a part, by a quarter, and so on down to FINEST_M
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from statistics import fmean

from msgspec import Struct

from upwash.config import Document, DroneConfig, waypoints
from upwash.core.geo import Position
from upwash.errors import UsageError
from upwash.lab.campaigns.campaign import Fly
from upwash.preflight.prediction import changed, predict

STEPS = 6  # middles along each side of the field
FINEST_M = 5.0  # nobody puts a box down more exactly

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
    silent = _silent(document)
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
    best = best_places(way, len(servers), trials)
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
    less_s = trials.time_s(best_places(way, max(0, len(best) - 1), trials))
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


def best_places(way: Sequence[Position], servers: int, trials: Trials) -> Places:
    """The best places found for that many servers; fewer if one more gains nothing."""
    field = candidates(way)
    best: Places = ()
    for count in range(1, servers + 1):
        one_more = trials.best([(*best, at) for at in field], than=best)
        starts = [start for start in (one_more, _spread(way, count)) if len(start) == count]
        settled = [_pushed(_improved(start, lambda _: field, trials), way, trials) for start in starts]
        found = trials.best(settled, than=best)
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


def _spread(way: Sequence[Position], count: int) -> Places:
    ends = [round(part * len(way) / count) for part in range(count + 1)]
    parts = [way[first:last] for first, last in itertools.pairwise(ends) if first < last]
    return tuple(
        Position(fmean(at.east_m for at in part), fmean(at.north_m for at in part)) for part in parts
    )


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


def _silent(document: Document) -> Document:
    """Without noise, which would favour a lucky place."""
    other = changed(document)
    other.pop("noise", None)
    return other


def _free_names(config: DroneConfig) -> Iterator[str]:
    taken = {server.name for server in config.servers}
    return (name for name in (f"new{number}" for number in itertools.count(1)) if name not in taken)
