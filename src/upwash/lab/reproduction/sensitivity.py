"""How far each mission time moves when a parameter that the thesis does not print exactly is another."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from statistics import fmean
from typing import Any, NamedTuple

import msgspec

from upwash.config import DroneConfig, HeatConfig, NoiseConfig, ServerConfig, pace_in_numbers
from upwash.lab.reproduction.cells import SETUPS, CellFlight, ThesisCell, fly_all, scenario, timed_cells

_SEEDS = 4
_replace = msgspec.structs.replace


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
        (label, CellFlight(cell, seed, partial(_varied, label)))
        for label in ("", *VARIATIONS)
        for setup in SETUPS
        for cell in timed_cells(setup)
        if not label or _concerns(label, cell)
        for seed in range(1, seeds + 1)
    ]


def _concerns(label: str, cell: ThesisCell) -> bool:
    """Whether it can change the mission: without offloading, servers have no effect."""
    config = scenario(cell, seed=1)
    beside_the_servers = _replace(_varied(label, config), servers=config.servers, noise=config.noise)
    return cell.policy != "local-only" or beside_the_servers != config


def _varied(label: str, config: DroneConfig) -> DroneConfig:
    return VARIATIONS[label](config) if label else config


# --- the variations ---------------------------------------------------------------------------------------------


def _servers(change: Callable[[ServerConfig], dict[str, Any]]) -> Callable[[DroneConfig], DroneConfig]:
    """Changes each server."""
    return lambda config: _replace(
        config, servers=tuple(_replace(server, **change(server)) for server in config.servers)
    )


def _range(range_m: float) -> Callable[[DroneConfig], DroneConfig]:
    return _servers(lambda _: {"range_m": range_m})


def _shifted(*, east_m: float = 0.0, north_m: float = 0.0) -> Callable[[DroneConfig], DroneConfig]:
    return _servers(
        lambda server: {
            "east_m": _known(server.east_m) + east_m,
            "north_m": _known(server.north_m) + north_m,
        }
    )


def _known(place_m: float | None) -> float:
    assert place_m is not None  # noqa: S101 - both set-ups place their servers in metres
    return place_m


def _on_the_border(range_m: float) -> Callable[[DroneConfig], DroneConfig]:
    """Twenty waypoints are exactly 100 m from a server there."""
    places_m = {"s1": 80.0, "s2": 120.0}
    return _servers(
        lambda server: dict.fromkeys(("east_m", "north_m"), places_m[server.name]) | {"range_m": range_m}
    )


def _exchanged(config: DroneConfig) -> DroneConfig:
    s1, s2 = config.servers
    places = {"s1": s2, "s2": s1}
    return _servers(
        lambda server: {"east_m": places[server.name].east_m, "north_m": places[server.name].north_m}
    )(config)


def _join(join_s: float) -> Callable[[DroneConfig], DroneConfig]:
    return _servers(
        lambda server: {
            "check_running_s": join_s,
            "check_s": server.check_s - server.check_running_s + join_s,
        }
    )


def _start(start_s: float) -> Callable[[DroneConfig], DroneConfig]:
    return _servers(lambda server: {"check_s": server.check_running_s + start_s})


def _punctual(config: DroneConfig) -> DroneConfig:
    return _replace(config, noise=NoiseConfig(call=config.noise.call, leg=config.noise.leg))


def _heat(warmer_k: float, config: DroneConfig) -> DroneConfig:
    assert isinstance(config.heat, HeatConfig)  # noqa: S101 - both set-ups have it
    return _replace(config, heat=_replace(config.heat, ambient_c=config.heat.ambient_c + warmer_k))


def _acceleration(faster: float, config: DroneConfig) -> DroneConfig:
    acceleration_m_s2 = pace_in_numbers(config.vehicle).acceleration_m_s2 + faster
    return _replace(config, vehicle=_replace(config.vehicle, acceleration_m_s2=acceleration_m_s2))


def _warm(config: DroneConfig) -> DroneConfig:
    services = tuple(_replace(service, local_first_extra_s=0.0) for service in config.services)
    return _replace(config, services=services)


_RANGES_M = (95.0, 97.5, 99.0, 99.5, 99.9, 100.1, 100.5, 101.0, 102.5, 105.0)
VARIATIONS: Mapping[
    str, Callable[[DroneConfig], DroneConfig]
] = {  # each within the range that fits the thesis
    **{f"range {range_m:g} m": _range(range_m) for range_m in _RANGES_M},
    "places 2 m east": _shifted(east_m=2.0),
    "places 2 m north": _shifted(north_m=2.0),
    "places 5 m east": _shifted(east_m=5.0),
    "places 5 m north": _shifted(north_m=5.0),
    "s1 and s2 exchanged": _exchanged,
    "places (80, 80), (120, 120)": _on_the_border(100.0),
    "  and range 99.9 m": _on_the_border(99.9),
    **{f"join {join_s:g} s": _join(join_s) for join_s in (2.5, 4.5)},
    **{f"start {start_s:g} s": _start(start_s) for start_s in (6.0, 10.0)},
    "no noise of joins, starts": _punctual,
    **{f"heat {warmer_k:+g} K": partial(_heat, warmer_k) for warmer_k in (-1.0, 1.0)},
    **{f"acceleration {faster:+g} m/s²": partial(_acceleration, faster) for faster in (-0.1, 0.1)},
    "no cold local call": _warm,
}
