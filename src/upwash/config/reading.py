"""From a TOML file to a typed value, or to a ConfigError that says what to change.

msgspec checks the types; `explanation` puts its errors into words.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TypeVar

import msgspec

from upwash.config.coverage import CoverageFile
from upwash.config.problems import Document, Problem, refuse_first
from upwash.config.values import PlanFile, SettingsTable
from upwash.errors import ConfigError
from upwash.support.input_files import read_file, read_toml, text_of, why_unreadable

T = TypeVar("T")

_MOST_BYTES = 1_000_000  # some 40,000 waypoints
_MOST_NESTED = 12
_ENDLESS = re.compile(r"server\b.*\.turn_s")  # keys whose values may be without end


def read_document(file: Path) -> Document:
    """The file's tables as plain values; every number in them is finite, or of an endless turn, and fits 64 bits."""
    try:
        text = text_of(read_file(file, most_bytes=_MOST_BYTES))
    except FileNotFoundError:
        raise ConfigError(str(file), "", "no such file: check the path") from None
    except (OSError, ValueError) as error:
        raise ConfigError(str(file), "", _unreadable(error)) from None
    try:
        document = read_toml(text)
    except ValueError as error:
        raise ConfigError(str(file), "", f"not valid TOML: {error}") from None
    refuse_first(file, impossible_values(document, ""))
    return document


def convert(
    document: Mapping[str, object],
    kind: type[T],
    *,
    file: Path,
    as_written: Mapping[str, object],
    at: str = "",
) -> T:
    """The document as a value of that kind; paths in it count from the file's folder.

    `as_written` is the document before shorthands were written out: error messages quote it. `at` is the key of a
    document that is a table of the file's.
    """
    folder = file.absolute().parent

    def resolve(kind: type, value: object) -> Path | CoverageFile | PlanFile | SettingsTable:
        if kind is SettingsTable and isinstance(value, dict):
            return SettingsTable(file, value)
        if kind not in (Path, CoverageFile, PlanFile) or not isinstance(value, str) or not value:
            raise ValueError
        of_file: type[Path | CoverageFile | PlanFile] = kind
        return of_file(folder / value)

    try:
        return msgspec.convert(document, kind, dec_hook=resolve)
    except msgspec.ValidationError as error:
        from upwash.config.explanation import explained  # only needed once something is wrong

        key, problem = explained(error, as_written, kind)
        raise ConfigError(str(file), ".".join(filter(None, (at, key))), problem) from None


def _unreadable(error: OSError | ValueError) -> str:
    if isinstance(error, UnicodeDecodeError):
        return f"not UTF-8 text (byte {error.start}): save it as UTF-8"
    return f"cannot be read ({why_unreadable(error)}): name a readable file"


def impossible_values(value: object, key: str, depth: int = 0) -> Iterator[Problem]:
    """What no value of a key may be: infinite, but for turns, longer than 64 bits, or nested without end."""
    match value:
        case math.inf if _ENDLESS.fullmatch(key):
            pass
        case dict() | list() if depth >= _MOST_NESTED:
            yield key, "nested too deeply: no value lies that deep"
        case dict():
            for name, inner in value.items():
                yield from impossible_values(inner, f"{key}.{name}" if key else name, depth + 1)
        case list():
            for index, inner in enumerate(value):
                yield from impossible_values(inner, f"{key}[{index}]", depth + 1)
        case float() if not math.isfinite(value):
            yield key, f"expected a finite number, found {value}"
        case int() if value.bit_length() > 63:
            yield key, "expected a number that fits 64 bits"
