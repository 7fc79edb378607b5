"""Which runs a campaign is made of: a scenario, each combination of the settings, each seed."""

from __future__ import annotations

import copy
import hashlib
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import msgspec

from upwash.config import Document, drone_config, impossible_values, read_document
from upwash.config.values import repeated
from upwash.errors import ConfigError, UsageError
from upwash.missions.bundled import load_mission, load_services
from upwash.support.input_files import read_toml

_DRONES = "drones"


@dataclass(frozen=True, slots=True)
class Setting:
    """One key of the scenario, and the values that it takes in turn."""

    key: str
    values: tuple[object, ...]


@dataclass(frozen=True, slots=True)
class Combination:
    """A value for each setting, as written in TOML, and the scenario's document with these values."""

    values: tuple[str, ...]
    document: Document


@dataclass(frozen=True, slots=True)
class Sweep:
    """All combinations, each to be flown with the seeds 1 to `seeds`."""

    file: Path
    settings: tuple[Setting, ...]
    combinations: tuple[Combination, ...]
    seeds: int

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that are set."""
        return tuple(setting.key for setting in self.settings)

    @property
    def fingerprint(self) -> str:
        """Changes with anything that is flown, but not with the number of seeds."""
        flown = [(each.values, each.document) for each in self.combinations]
        return hashlib.sha256(msgspec.json.encode([self.keys, flown], order="sorted")).hexdigest()[:16]


def read_sweep(file: Path, settings: Sequence[str], *, seeds: int) -> Sweep:
    """The sweep over a scenario with settings `KEY=V1,V2…`; every combination can be flown.

    Raises ConfigError with the key for a scenario that would be refused by itself, and UsageError for a setting
    that cannot be understood.
    """
    document = read_document(file)
    drone_config(document, file)  # so that what is wrong without any setting is not blamed on one
    read = tuple(read_setting(text) for text in settings)
    for _, key in repeated([setting.key for setting in read]):
        raise UsageError(f"{key} is set twice: give all its values at once, {key}=V1,V2")
    combinations = tuple(_combinations(document, file, read))
    for combination in combinations:
        config = drone_config(combination.document, file)
        load_mission(config.mission.program, mode=config.mission.mode)
        load_services(config.services)
    return Sweep(file, read, combinations, seeds)


def read_setting(text: str) -> Setting:
    """The setting that `KEY=V1,V2…` says: TOML values, where strings need no quotes; raises UsageError."""
    key, equals, written = (part.strip() for part in text.partition("="))
    if not key or not equals or not written:
        raise UsageError(f'setting "{text}" is not KEY=V1,V2…, such as policy.gain_wait=0.1,0.25')
    if key == "seed":
        raise UsageError("seed cannot be set: every combination is flown with the seeds 1 to N")
    values = tuple(_read_values(written))
    for _, again in repeated([_written(value) for value in values]):
        raise UsageError(f"{key} is set to {again} twice: give each value once")
    return Setting(key, values)


def read_overrides(texts: Sequence[str]) -> dict[str, object]:
    """The values by their keys that settings `KEY=VALUE` say; UsageError for several values of a key."""
    overrides: dict[str, object] = {}
    for text in texts:
        setting = read_setting(text)
        if len(setting.values) > 1 or setting.key in overrides:
            raise UsageError(f"{setting.key} has several values, and is to have one: {setting.key}=VALUE")
        overrides[setting.key] = setting.values[0]
    return overrides


def with_value(document: Document, file: Path, key: str, value: object) -> Document:
    """The document with one value changed or added.

    A step of the key names a table's key; in an array of tables it is the `name` of one, or its number from 0. The
    key `drones` leaves so many of the `[[drone]]` tables, the first ones. Raises ConfigError where the key leads
    nowhere.
    """
    changed = copy.deepcopy(document)
    if key == _DRONES:
        drones = changed.get("drone")
        changed["drone"] = _first_drones(drones if isinstance(drones, list) else [], value, file)
        return changed
    _set(changed, key, value, file=file, walked="")
    return changed


def _first_drones(drones: list[Any], count: object, file: Path) -> list[Any]:
    if type(count) is not int or count < 1:
        raise ConfigError(
            str(file), _DRONES, f"expected a number of drones from 1 on, found {_written(count)}"
        )
    if count > len(drones):
        raise ConfigError(
            str(file),
            _DRONES,
            f"{count} are asked for, and the file has {len(drones)} [[drone]] tables: add some, or ask for fewer",
        )
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


def _combinations(document: Document, file: Path, settings: Sequence[Setting]) -> Iterator[Combination]:
    for values in itertools.product(*(setting.values for setting in settings)):
        changed = document
        for setting, value in zip(settings, values, strict=True):
            for key, problem in impossible_values(value, setting.key):
                raise ConfigError(str(file), key, problem)
            changed = with_value(changed, file, setting.key, value)
        yield Combination(tuple(_written(value) for value in values), changed)


def _first_step(table: object, key: str) -> tuple[str, str]:
    """The first step of a key and the rest of it; a name in an array may itself have dots."""
    names = [each for each in _names(table) if f"{key}.".startswith(f"{each}.")]
    step = max(names, key=len) if names else key.partition(".")[0]
    return step, key[len(step) + 1 :]


def _names(table: object) -> list[str]:
    if not isinstance(table, list):
        return []
    return [str(each["name"]) for each in table if isinstance(each, dict) and "name" in each]


def _element(tables: list[Any], step: str, file: Path, walked: str) -> Any:
    names = _names(tables)
    if step in names:
        return tables[names.index(step)]
    if not names and step.isdecimal() and int(step) < len(tables):
        return tables[int(step)]
    allowed = ", ".join(names) or f"the numbers from 0 to {len(tables) - 1}"
    raise ConfigError(str(file), walked, f'there is no "{step}"; allowed: {allowed}')


def _read_values(written: str) -> list[object]:
    try:
        return list(_toml_array(written))
    except ValueError:
        return [_read_value(part.strip()) for part in written.split(",")]


def _read_value(written: str) -> object:
    try:
        (value,) = _toml_array(written)
    except ValueError:
        return written
    return value


def _toml_array(items: str) -> list[object]:
    return cast(list[object], read_toml(f"values = [{items}]")["values"])


def _written(value: object) -> str:
    if value == math.inf:  # which JSON has no number for
        return "inf"
    return value if isinstance(value, str) else msgspec.json.encode(value).decode()
