"""How far each mission time moves when a parameter that the thesis does not print exactly is another."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from statistics import fmean
from typing import NamedTuple

import msgspec

from upwash.config import DroneConfig, HeatConfig, NoiseConfig, pace_in_numbers
from upwash.lab.reproduction.cells import (
    SETUPS,
    CellFlight,
    ThesisCell,
    fly_all,
    scenario,
    timed_cells,
    unchanged,
)

_SEEDS = 4
_replace = msgspec.structs.replace


class Variation(NamedTuple):
    """One change of both set-ups, and what it is called."""

    label: str
    change: Callable[[DroneConfig], DroneConfig]


_AS_IT_IS = Variation("", unchanged)


class Moved(NamedTuple):
    """By how many percent a variation changes the mean mission time of each cell that Table 4.1 prints."""

    label: str
    percent: Mapping[str, Sequence[float]]  # by set-up, in the order of timed_cells()


def variations() -> tuple[Variation, ...]:
    """One parameter at a time, each in a range in which the thesis could have had it."""
    return (
        *(Variation(f"range {range_m:g} m", partial(_range, range_m=range_m)) for range_m in _RANGES_M),
        Variation("places 2 m east", partial(_moved, east_m=2.0)),
        Variation("places 2 m north", partial(_moved, north_m=2.0)),
        Variation("places 5 m east", partial(_moved, east_m=5.0)),
        Variation("places 5 m north", partial(_moved, north_m=5.0)),
        Variation("s1 and s2 exchanged", _exchanged),
        Variation("places (80, 80), (120, 120)", _on_the_border),
        Variation("  and range 99.9 m", partial(_on_the_border, range_m=99.9)),
        *(Variation(f"join {join_s:g} s", partial(_join, join_s=join_s)) for join_s in (2.5, 4.5)),
        *(Variation(f"start {start_s:g} s", partial(_start, start_s=start_s)) for start_s in (6.0, 10.0)),
        Variation("no noise of joins, starts", _punctual),
        *(Variation(f"heat {warmer_k:+g} K", partial(_heat, warmer_k=warmer_k)) for warmer_k in (-1.0, 1.0)),
        *(
            Variation(f"acceleration {faster:+g} m/s²", partial(_acceleration, faster=faster))
            for faster in (-0.1, 0.1)
        ),
        Variation("no cold local call", _warm),
    )


def moved(
    *, seeds: int = _SEEDS, workers: int | None = None, progress: Callable[[], None] = lambda: None
) -> list[Moved]:
    """Flies every cell as it is and in each variation, calling `progress` after each of `missions()` missions."""
    flights = _flights(seeds)
    times_min: dict[tuple[str, ThesisCell], list[float]] = {}
    for (label, flight), flown in zip(
        flights,
        fly_all([flight for _, flight in flights], workers=workers, progress=progress),
        strict=True,
    ):
        times_min.setdefault((label, flight.cell), []).append(flown.mission_min)
    means = {key: fmean(values) for key, values in times_min.items()}

    def percent(label: str, cell: ThesisCell) -> float:
        as_it_is = means[_AS_IT_IS.label, cell]
        return 100 * (means.get((label, cell), as_it_is) / as_it_is - 1)

    return [
        Moved(
            each.label,
            {setup: [percent(each.label, cell) for cell in timed_cells(setup)] for setup in SETUPS},
        )
        for each in variations()
    ]


def missions(seeds: int = _SEEDS) -> int:
    """How many missions that are."""
    return len(_flights(seeds))


def _flights(seeds: int) -> list[tuple[str, CellFlight]]:
    return [
        (each.label, CellFlight(cell, seed, each.change))
        for each in (_AS_IT_IS, *variations())
        for cell in _cells()
        if each is _AS_IT_IS or _concerns(each, cell)
        for seed in range(1, seeds + 1)
    ]


def _concerns(variation: Variation, cell: ThesisCell) -> bool:
    """Whether it can change the mission: without offloading, servers have no effect."""
    config = scenario(cell, seed=1)
    changed = variation.change(config)
    beside_the_servers = _replace(changed, servers=config.servers, noise=config.noise)
    return cell.policy != "local-only" or beside_the_servers != config


def _cells() -> list[ThesisCell]:
    return [cell for setup in SETUPS for cell in timed_cells(setup)]


# --- the changes ------------------------------------------------------------------------------------------------

_RANGES_M = (95.0, 97.5, 99.0, 99.5, 99.9, 100.1, 100.5, 101.0, 102.5, 105.0)


def _range(config: DroneConfig, *, range_m: float) -> DroneConfig:
    return _replace(config, servers=tuple(_replace(each, range_m=range_m) for each in config.servers))


def _moved(config: DroneConfig, *, east_m: float = 0.0, north_m: float = 0.0) -> DroneConfig:
    servers = tuple(
        _replace(each, east_m=_known(each.east_m) + east_m, north_m=_known(each.north_m) + north_m)
        for each in config.servers
    )
    return _replace(config, servers=servers)


def _exchanged(config: DroneConfig) -> DroneConfig:
    s1, s2 = config.servers
    return _replace(
        config,
        servers=(
            _replace(s1, east_m=s2.east_m, north_m=s2.north_m),
            _replace(s2, east_m=s1.east_m, north_m=s1.north_m),
        ),
    )


def _on_the_border(config: DroneConfig, *, range_m: float = 100.0) -> DroneConfig:
    """Twenty waypoints are exactly 100 m from a server there."""
    s1, s2 = config.servers
    return _replace(
        config,
        servers=(
            _replace(s1, east_m=80.0, north_m=80.0, range_m=range_m),
            _replace(s2, east_m=120.0, north_m=120.0, range_m=range_m),
        ),
    )


def _join(config: DroneConfig, *, join_s: float) -> DroneConfig:
    servers = tuple(
        _replace(each, check_running_s=join_s, check_s=each.check_s - each.check_running_s + join_s)
        for each in config.servers
    )
    return _replace(config, servers=servers)


def _start(config: DroneConfig, *, start_s: float) -> DroneConfig:
    servers = tuple(_replace(each, check_s=each.check_running_s + start_s) for each in config.servers)
    return _replace(config, servers=servers)


def _punctual(config: DroneConfig) -> DroneConfig:
    return _replace(config, noise=NoiseConfig(call=config.noise.call, leg=config.noise.leg))


def _heat(config: DroneConfig, *, warmer_k: float) -> DroneConfig:
    assert isinstance(config.heat, HeatConfig)  # noqa: S101 - both set-ups have it
    return _replace(config, heat=_replace(config.heat, ambient_c=config.heat.ambient_c + warmer_k))


def _acceleration(config: DroneConfig, *, faster: float) -> DroneConfig:
    acceleration_m_s2 = pace_in_numbers(config.vehicle).acceleration_m_s2 + faster
    return _replace(config, vehicle=_replace(config.vehicle, acceleration_m_s2=acceleration_m_s2))


def _warm(config: DroneConfig) -> DroneConfig:
    return _replace(
        config, services=tuple(_replace(each, local_first_extra_s=0.0) for each in config.services)
    )


def _known(place_m: float | None) -> float:
    assert place_m is not None  # noqa: S101 - both set-ups place their servers in metres
    return place_m
