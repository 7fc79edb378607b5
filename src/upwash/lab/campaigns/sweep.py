"""The runs of a campaign: a scenario, with each combination of settings and each seed."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import msgspec

from upwash.config.drone_file import drone_config
from upwash.config.problems import impossible_values, repeated
from upwash.config.reading import Document, read_document
from upwash.errors import ConfigError, UsageError
from upwash.lab.scenario import with_value, written
from upwash.missions.bundled import load_services
from upwash.missions.program import load_mission
from upwash.support.input_files import read_toml


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
class ParameterSweep:
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
        """A hash that changes with every setting and scenario value, but not with the number of seeds."""
        flown = [(combination.values, combination.document) for combination in self.combinations]
        return hashlib.sha256(msgspec.json.encode([self.keys, flown], order="sorted")).hexdigest()[:16]


def read_sweep(file: Path, settings: Sequence[str], *, seeds: int) -> ParameterSweep:
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
    return ParameterSweep(file, read, combinations, seeds)


def read_setting(text: str) -> Setting:
    """The setting that `KEY=V1,V2…` says: TOML values, where strings need no quotes; raises UsageError."""
    key, equals, text_of_values = (part.strip() for part in text.partition("="))
    if not key or not equals or not text_of_values:
        raise UsageError(f'setting "{text}" is not KEY=V1,V2…, such as policy.gain_wait=0.1,0.25')
    if key == "seed":
        raise UsageError("seed cannot be set: every combination is flown with the seeds 1 to N")
    values = tuple(_read_values(text_of_values))
    for _, again in repeated([written(value) for value in values]):
        raise UsageError(f"{key} is set to {again} twice: give each value once")
    return Setting(key, values)


def read_overrides(texts: Sequence[str]) -> dict[str, object]:
    """The values by their keys that settings `KEY=VALUE` say; UsageError for several values of a key."""
    overrides: dict[str, object] = {}
    for text in texts:
        setting = read_setting(text)
        if len(setting.values) > 1 or setting.key in overrides:
            raise UsageError(f"{setting.key} has several values: give one, {setting.key}=VALUE")
        overrides[setting.key] = setting.values[0]
    return overrides


def _combinations(document: Document, file: Path, settings: Sequence[Setting]) -> Iterator[Combination]:
    for values in itertools.product(*(setting.values for setting in settings)):
        changed = document
        for setting, value in zip(settings, values, strict=True):
            for key, problem in impossible_values(value, setting.key):
                raise ConfigError(str(file), key, problem)
            changed = with_value(changed, file, setting.key, value)
        yield Combination(tuple(written(value) for value in values), changed)


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
