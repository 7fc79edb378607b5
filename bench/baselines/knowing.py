"""Staying or going with known probabilities: a drone that knows at each place how likely a demand is.

The thesis's heavy mission, on the drone alone and with its servers. The drone that knows decides as `learn` does, and
has the true probability of the photo's place instead of an estimate.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

from bench.demands import FIELDS
from bench.stay_or_go import ACTION_S, NOISE, SCENARIO
from msgspec import Struct

from upwash.core.geo import Position
from upwash.core.planning.demand_map import DemandMap
from upwash.lab.run import simulate
from upwash.lab.scenario import read_scenario
from upwash.support.confidence import mean_of

CORNER = {"east_m": 160.0, "north_m": 160.0, "radius_m": 60.0}
CHANCES, QUICK_CHANCES = ("0 %", "10 %", "20 %", "50 %", *list(FIELDS)[:2]), ("10 %",)
CALLS = ("alone, 10 s", "alone, 3 s", "servers, 0.7 s", "servers, 4 s")
MANNERS = ("stay", "go", "learn", "knows")
_NO_MAP = str(Path(__file__).parent / "no such folder" / "demands.json")


class Flight(NamedTuple):
    """A mission to be flown in each of the MANNERS."""

    calls: str
    chance: str
    seed: int


class Known(Struct, frozen=True, kw_only=True):
    """What the manners take: minutes, and the gain over the drone that stays, in %, ± 95 %, by manner."""

    calls: str
    chance: str
    stay_min: float
    gains: dict[str, tuple[float, float]]


def event_of(chance: str) -> dict[str, Any]:
    """The `[event]` table of that name."""
    if chance not in FIELDS:
        return {"probability": float(chance.removesuffix(" %")) / 100}
    everywhere, corner = FIELDS[chance]
    return {"probability": everywhere, "areas": [{**CORNER, "probability": corner}]}


def fly(flight: Flight) -> tuple[Flight, dict[str, float]]:
    """The times (s) of the missions, by manner."""
    call_s = float(flight.calls.rpartition(", ")[2].removesuffix(" s"))
    alone = flight.calls.startswith("alone")
    overrides: dict[str, Any] = {"event": event_of(flight.chance), "mission.action_s": ACTION_S, **NOISE}
    overrides |= (
        {"service.detector.local_call_s.heavy": call_s}
        if alone
        else {f"server.{name}.remote_call_s": call_s for name in ("s1", "s2")}
    )
    times_s = {}
    for manner in MANNERS:
        known = {"policy.demand_map": _NO_MAP} if manner == "knows" else {}
        own = {**overrides, **known, "policy.stay_or_go": "learn" if manner == "knows" else manner}
        config = read_scenario(
            SCENARIO, policy="local-only" if alone else "look-ahead", seed=flight.seed, overrides=own
        )
        chance_at = config.event.chance if config.event else None
        with knowing(chance_at) if manner == "knows" else contextlib.nullcontext():
            run = simulate(config)
        assert run.result.completed
        times_s[manner] = run.result.mission_time_s
    return flight, times_s


@contextlib.contextmanager
def knowing(chance_at: Any) -> Iterator[None]:
    """Drones with a map of demands that has the truth."""

    def chance(self: DemandMap, position: Position, everywhere: float) -> float:
        return float(chance_at(position))

    with patch.object(DemandMap, "chance", chance):
        yield


def rows(flown: Mapping[Flight, Mapping[str, float]]) -> Iterator[Known]:
    """A row for each kind of calls and of demands, over the seeds."""
    groups: dict[tuple[str, str], list[Mapping[str, float]]] = {}
    for flight, times_s in flown.items():
        groups.setdefault((flight.calls, flight.chance), []).append(times_s)
    for (calls, chance), missions in groups.items():
        stays_s = [mission["stay"] for mission in missions]
        gains = {manner: _gain(missions, manner) for manner in MANNERS[1:]}
        yield Known(calls=calls, chance=chance, stay_min=mean_of(stays_s).value / 60, gains=gains)


def _gain(missions: Sequence[Mapping[str, float]], manner: str) -> tuple[float, float]:
    gain = mean_of([100 * (1 - mission[manner] / mission["stay"]) for mission in missions])
    return gain.value, gain.margin
