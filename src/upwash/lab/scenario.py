"""Scenarios as they are simulated: read, and changed by key, policy and seed."""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.config.problems import impossible_values
from upwash.config.reading import Document, read_document, refuse_first
from upwash.errors import ConfigError

_DRONES = "drones"


def with_value(document: Document, file: Path, key: str, value: object) -> Document:
    """The document with one value changed or added.

    A step of the key names a table's key; in an array of tables it is the `name` of a table, or its number from 0.
    The key `drones` keeps that number of the `[[drone]]` tables. Raises ConfigError for a key that leads nowhere.
    """
    changed = copy.deepcopy(document)
    if key == _DRONES:
        drones = changed.get("drone")
        changed["drone"] = _first_drones(drones if isinstance(drones, list) else [], value, file)
        return changed
    _set(changed, key, value, file=file, walked="")
    return changed


def value_at(document: Document, file: Path, key: str) -> Any:
    """The value of the key, whose steps are those of `with_value`."""
    found: Any = document
    while key:
        step, key = _first_step(found, key)
        found = _element(found, step, file, "") if isinstance(found, list) else found[step]
    return found


def _first_drones(drones: list[Any], count: object, file: Path) -> list[Any]:
    if type(count) is not int or count < 1:
        problem = f"expected a number of drones from 1 on, found {written(count)}"
        raise ConfigError(str(file), _DRONES, problem)
    if count > len(drones):
        has = f"{count} are more than the file has: {len(drones)} [[drone]] tables"
        raise ConfigError(str(file), _DRONES, f"{has}: add some, or ask for fewer")
    return drones[:count]


def _set(table: Any, key: str, value: object, *, file: Path, walked: str) -> None:
    step, rest = _first_step(table, key)
    here = f"{walked}.{step}" if walked else step
    match table:
        case dict() if not rest:
            table[step] = value
            return
        case dict():
            inner = table.setdefault(step, {})
        case list() if rest:
            inner = _element(table, step, file, walked)
        case list():
            raise ConfigError(str(file), here, "is a whole table: set one of its keys")
        case _:
            raise ConfigError(str(file), walked, f'is no table: it has no key "{step}" to be set')
    _set(inner, rest, value, file=file, walked=here)


def _first_step(table: object, key: str) -> tuple[str, str]:
    """The first step of a key and the rest of it; the name of a table in an array may contain dots."""
    names = [name for name in _names(table) if f"{key}.".startswith(f"{name}.")]
    step = max(names, key=len) if names else key.partition(".")[0]
    return step, key[len(step) + 1 :]


def _names(table: object) -> list[str]:
    if not isinstance(table, list):
        return []
    return [str(item["name"]) for item in table if isinstance(item, dict) and "name" in item]


def _element(tables: list[Any], step: str, file: Path, walked: str) -> Any:
    names = _names(tables)
    if step in names:
        return tables[names.index(step)]
    if not names and step.isdecimal() and int(step) < len(tables):
        return tables[int(step)]
    allowed = ", ".join(names) or f"the numbers from 0 to {len(tables) - 1}"
    raise ConfigError(str(file), walked, f'there is no "{step}"; allowed: {allowed}')


def written(value: object) -> str:
    """The value as a setting has it: JSON, with strings in no quotes."""
    if value == math.inf:  # which JSON has no number for
        return "inf"
    return value if isinstance(value, str) else msgspec.json.encode(value).decode()


_UNNAMED = Path("scenario")  # what a scenario without a file is called in errors


def read_scenario(
    scenario: str | os.PathLike[str] | Mapping[str, object],
    *,
    policy: str | None = None,
    seed: int | None = None,
    overrides: Mapping[str, object] | None = None,
) -> DroneConfig:
    """The scenario as `simulate` flies it; a policy that is given is every drone's. Raises ConfigError.

    The file of a policy that is given counts from the current folder.
    """
    document, file = scenario_tables(scenario, policy=policy, seed=seed, overrides=overrides)
    return drone_config(document, file)


def scenario_tables(
    scenario: str | os.PathLike[str] | Mapping[str, object],
    *,
    policy: str | None = None,
    seed: int | None = None,
    overrides: Mapping[str, object] | None = None,
) -> tuple[Document, Path]:
    """The tables of the scenario that `read_scenario` reads, and their file."""
    if isinstance(scenario, Mapping):
        file = _UNNAMED
        document: Document = _plain(dict(scenario), "", file)
    else:
        file = Path(scenario)
        document = read_document(file)
    if policy is not None:
        document = _without_own_policies(document)
        policy = str(Path(policy).absolute()) if ".py:" in policy else policy
    instead = {"policy.name": policy, "seed": seed}
    changes = {**(overrides or {}), **{key: value for key, value in instead.items() if value is not None}}
    for key, value in changes.items():
        document = with_value(document, file, key, _plain(value, key, file))
    return document, file


def told(document: Document) -> Document:
    """The tables without what may have secrets: results go to strangers."""
    shown = {key: value for key, value in document.items() if key not in ("user", "keys")}
    if isinstance(camera := shown.get("camera"), dict):
        shown["camera"] = {key: value for key, value in camera.items() if key != "device"}
    return shown


def _without_own_policies(document: Document) -> Document:
    drones = document.get("drone")
    if not isinstance(drones, list):
        return document

    def without(drone: Any) -> Any:
        tables = drone.items() if isinstance(drone, dict) else ()
        return {key: value for key, value in tables if key != "policy"} if tables else drone

    return document | {"drone": list(map(without, drones))}


def _plain(value: object, key: str, file: Path) -> Any:
    """The value as TOML has it; notebooks pass tuples, paths and numpy's numbers too."""
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
    """The same scenario under another policy, for all of its drones."""
    policy = config.policy.under(name)
    drones = tuple(msgspec.structs.replace(drone, policy=None) for drone in config.drones)
    return msgspec.structs.replace(config, policy=policy, drones=drones)


def as_toml(document: Document) -> str:
    """The document as a file that says the same."""
    lines = [f"{key} = {_toml(value)}" for key, value in document.items() if not _is_table(value)]
    for key, value in document.items():
        if not _is_table(value):
            continue
        for table in value if isinstance(value, list) else [value]:
            lines += ["", f"[[{key}]]" if isinstance(value, list) else f"[{key}]"]
            lines += [f"{name} = {_toml(item)}" for name, item in table.items()]
    return "\n".join(lines) + "\n"


def _is_table(value: object) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and all(isinstance(item, dict) for item in value)
    )


def _toml(value: object) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return f'"{value}"'
        case dict():
            inner = ", ".join(f'"{key}" = {_toml(item)}' for key, item in value.items())
            return f"{{ {inner} }}"
        case list():
            return f"[{', '.join(_toml(item) for item in value)}]"
    return repr(value)
