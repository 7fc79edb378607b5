"""How far each mission time moves when a parameter that the thesis does not print exactly is another."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from statistics import fmean
from typing import NamedTuple

from upwash.lab.reproduction.cells import SETUPS, By, CellFlight, Changes, ThesisCell, fly_all, timed_cells

_SEEDS = 4


class Moved(NamedTuple):
    """By how many percent a variation changes the mean mission time of each cell that Table 4.1 prints."""

    label: str
    percent: Mapping[str, Sequence[float]]  # by set-up, in the order of timed_cells()


def moved(
    *, seeds: int = _SEEDS, workers: int | None = None, progress: Callable[[], None] = lambda: None
) -> list[Moved]:
    """Flies every cell as it is and in each variation, calling `progress` after each of `missions()` missions."""
    flights = _flights(seeds)
    results = fly_all([flight for _, flight in flights], workers=workers, progress=progress)
    times_min: dict[tuple[str, ThesisCell], list[float]] = {}
    for (label, flight), result in zip(flights, results, strict=True):
        times_min.setdefault((label, flight.cell), []).append(result.mission_min)
    means = {key: fmean(values) for key, values in times_min.items()}

    def percent(label: str, cell: ThesisCell) -> float:
        as_it_is = means["", cell]
        return 100 * (means.get((label, cell), as_it_is) / as_it_is - 1)

    return [
        Moved(label, {setup: [percent(label, cell) for cell in timed_cells(setup)] for setup in SETUPS})
        for label in VARIATIONS
    ]


def missions(seeds: int = _SEEDS) -> int:
    """The number of missions that `moved` flies."""
    return len(_flights(seeds))


def _flights(seeds: int) -> list[tuple[str, CellFlight]]:
    return [
        (label, CellFlight(cell, seed, changes))
        for label, changes in {"": {}, **VARIATIONS}.items()
        for setup in SETUPS
        for cell in timed_cells(setup)
        if not label
        or cell.policy != "local-only"
        or not all(key.startswith(("server.", "noise.")) for key in changes)  # no effect without offloading
        for seed in range(1, seeds + 1)
    ]


def _servers(**changes: float | By) -> Changes:
    return {f"server.{name}.{key}": change for name in ("s1", "s2") for key, change in changes.items()}


def _places(s1: tuple[float, float], s2: tuple[float, float], **both: float) -> Changes:
    places = {"s1": s1, "s2": s2}
    easts = {f"server.{name}.east_m": east_m for name, (east_m, _) in places.items()}
    norths = {f"server.{name}.north_m": north_m for name, (_, north_m) in places.items()}
    return {**easts, **norths, **_servers(**both)}


_RANGES_M = (95.0, 97.5, 99.0, 99.5, 99.9, 100.1, 100.5, 101.0, 102.5, 105.0)
_ON_THE_BORDER = (80.0, 80.0), (120.0, 120.0)  # twenty waypoints are exactly 100 m from a server there
_JOIN_S, _START_S = 3.5, 8.0  # of both set-ups
VARIATIONS: Mapping[str, Changes] = {  # each within the range that fits the thesis
    **{f"range {range_m:g} m": _servers(range_m=range_m) for range_m in _RANGES_M},
    "places 2 m east": _servers(east_m=By(2.0)),
    "places 2 m north": _servers(north_m=By(2.0)),
    "places 5 m east": _servers(east_m=By(5.0)),
    "places 5 m north": _servers(north_m=By(5.0)),
    "s1 and s2 exchanged": _places((130.0, 90.0), (70.0, 110.0)),
    "places (80, 80), (120, 120)": _places(*_ON_THE_BORDER, range_m=100.0),
    "  and range 99.9 m": _places(*_ON_THE_BORDER, range_m=99.9),
    **{f"join {s:g} s": _servers(check_running_s=s, check_s=_START_S + s) for s in (2.5, 4.5)},
    **{f"start {s:g} s": _servers(check_s=_JOIN_S + s) for s in (6.0, 10.0)},
    "no noise of joins, starts": {"noise.join": 0.0, "noise.start": 0.0},
    **{f"heat {k:+g} K": {"heat.ambient_c": By(k)} for k in (-1.0, 1.0)},
    **{f"acceleration {more:+g} m/s²": {"vehicle.acceleration_m_s2": By(more)} for more in (-0.1, 0.1)},
    "no cold local call": {"service.detector.local_first_extra_s": 0.0},
}
