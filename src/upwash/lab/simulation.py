"""One simulated mission: from a scenario to what it came to."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import msgspec

from upwash.config import Document, DroneConfig, coverage_kept, drone_config, impossible_values, read_document
from upwash.config.problems import refuse_first
from upwash.core.planning.bound import Bound
from upwash.errors import ConfigError, UsageError
from upwash.eventlog.results import RunResult
from upwash.eventlog.schema import Event
from upwash.lab.bounds import bound_of
from upwash.lab.run import Run
from upwash.lab.run import simulate as fly
from upwash.lab.sweep import with_value

_UNNAMED = Path("scenario")  # what a scenario without a file is called in errors


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation(RunResult):
    """One simulated mission: what it came to, the least times that it could have taken, and its events.

    `failure` says why it was not completed, "" where it was; then there is no bound either. `vanished` is whether
    that is because the scenario has the drone vanish.
    """

    scenario: str
    seed: int
    failure: str
    vanished: bool = False
    bound: Bound | None
    events: Sequence[Event] = field(repr=False)


def simulate(
    scenario: str | os.PathLike[str] | Mapping[str, object],
    *,
    policy: str | None = None,
    seed: int | None = None,
    overrides: Mapping[str, object] | None = None,
    keep_coverage: bool = False,
) -> Simulation:
    """Simulates one mission on virtual time: the same scenario and seed give the same mission.

    The scenario is a TOML file, or its tables as a dict, whose paths count from the current folder. A policy or a
    seed stands in for the scenario's, and `overrides` for other values of it, by keys such as `server.s1.range_m`:
    those of `upwash campaign --set`. With `keep_coverage` the scenario's `network.coverage_map` is written at the
    end, as by a flight.

    ConfigError for a scenario that cannot be flown, UsageError for what cannot be simulated, and MissionFailed for a
    mission program with a bug. What else ends a mission early is the result's `failure`. A scenario of several drones
    is for `simulate_fleet`.
    """
    config = read_scenario(scenario, policy=policy, seed=seed, overrides=overrides)
    if config.drones:
        raise UsageError(
            f"{name_of(scenario)} has [[drone]] tables ({len(config.drones)}), and one mission is to be simulated: "
            "call simulate_fleet"
        )
    if keep_coverage and config.network.coverage_map is None:
        raise UsageError(f"{name_of(scenario)} names no file for its coverage map: give network.coverage_map")
    run = fly(config)
    if keep_coverage and run.coverage is not None:
        coverage_kept(config, run.coverage)
    return simulation_of(run, config, bound_of(run, config), scenario=name_of(scenario))


def simulation_of(run: Run, config: DroneConfig, bound: Bound | None, *, scenario: str) -> Simulation:
    """What the run of that configuration came to."""
    result = {each.name: getattr(run.result, each.name) for each in fields(run.result)}
    return Simulation(
        **result | {"policy": config.policy.name},  # also of a mission that never began
        scenario=scenario,
        seed=config.seed,
        failure=run.failure,
        vanished=run.vanished,
        bound=bound,
        events=run.events.as_read(),
    )


def read_scenario(
    scenario: str | os.PathLike[str] | Mapping[str, object],
    *,
    policy: str | None = None,
    seed: int | None = None,
    overrides: Mapping[str, object] | None = None,
) -> DroneConfig:
    """The scenario as `simulate` flies it; a policy that is given is every drone's. Raises ConfigError."""
    if isinstance(scenario, Mapping):
        file = _UNNAMED
        document: Document = _plain(dict(scenario), "", file)
    else:
        file = Path(scenario)
        document = read_document(file)
    if policy is not None:
        document = _without_own_policies(document)
    instead = {"policy.name": policy, "seed": seed}
    changes = {**(overrides or {}), **{key: value for key, value in instead.items() if value is not None}}
    for key, value in changes.items():
        document = with_value(document, file, key, _plain(value, key, file))
    return drone_config(document, file)


def _without_own_policies(document: Document) -> Document:
    """The document with the file's policy for all of its drones."""
    drones = document.get("drone")
    if not isinstance(drones, list):
        return document
    return document | {
        "drone": [
            {key: value for key, value in drone.items() if key != "policy"}
            if isinstance(drone, dict)
            else drone
            for drone in drones
        ]
    }


def _plain(value: object, key: str, file: Path) -> Any:
    """The value as a TOML file would have it: a notebook's are tuples, paths and numpy's numbers too."""
    refuse_first(file, impossible_values(value, key))
    try:
        plain = msgspec.to_builtins(value, enc_hook=_plainer, str_keys=True)
        return msgspec.msgpack.decode(msgspec.msgpack.encode(plain))  # which makes lists of tuples
    except (TypeError, ValueError) as error:
        raise ConfigError(str(file), key, f"expected numbers, strings, lists and tables ({error})") from None


def _plainer(value: object) -> object:
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):  # of numpy
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is none of these")


def name_of(scenario: str | os.PathLike[str] | Mapping[str, object]) -> str:
    """What a scenario is called: as its file is, without the ending."""
    return str(_UNNAMED) if isinstance(scenario, Mapping) else Path(scenario).stem


def with_policy(config: DroneConfig, name: str) -> DroneConfig:
    """The same scenario under another policy, which must be one of PolicyConfig's, for all of its drones."""
    policy = msgspec.convert({**msgspec.structs.asdict(config.policy), "name": name}, type(config.policy))
    drones = tuple(msgspec.structs.replace(drone, policy=None) for drone in config.drones)
    return msgspec.structs.replace(config, policy=policy, drones=drones)
