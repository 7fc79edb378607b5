"""From a TOML file to a typed value, or to a ConfigError that says what to change.

msgspec checks the types; `explanation` puts its errors into words. Everything else is checked by generators of
`problems`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from upwash.config.problems import Problem, impossible_values
from upwash.config.values import NamedFile, SettingsTable
from upwash.errors import ConfigError
from upwash.support.input_files import named_text, read_named_file, read_toml
from upwash.support.spared import require_unnamed

T = TypeVar("T")
Document = dict[str, Any]

MOST_BYTES = 1_000_000  # some 40,000 waypoints


def read_document(file: Path) -> Document:
    """The file's tables as plain values; numbers are finite, except of an endless turn, and fit 64 bits."""
    return document_of(read_named_file(file, most_bytes=MOST_BYTES), file)


def document_of(content: bytes, file: Path) -> Document:
    """The same of the content of the file."""
    text = named_text(content, file)
    try:
        document = read_toml(text)
    except ValueError as error:
        raise ConfigError(str(file), "", f"not valid TOML: {error}") from None
    refuse_first(file, impossible_values(document, ""))
    require_unnamed(document, file)
    return document


def convert(
    document: Mapping[str, object],
    kind: type[T],
    *,
    file: Path,
    as_written: Mapping[str, object],
    at: str = "",
) -> T:
    """The document as a value of that kind; its paths count from the file's folder. Raises ConfigError.

    Error messages quote `as_written`, the document before shorthands were written out. `at` is the document's key, if
    the document is a table of the file.
    """
    folder = file.absolute().parent

    def resolve(kind: Any, value: object) -> Any:
        if kind is SettingsTable and isinstance(value, dict):
            return SettingsTable(file, value)
        if not issubclass(kind, Path | NamedFile) or not isinstance(value, str) or not value:
            raise ValueError
        return kind(folder / value)

    try:
        return msgspec.convert(document, kind, dec_hook=resolve)
    except msgspec.ValidationError as error:
        from upwash.config.explanation import explained  # only needed for errors

        key, problem = explained(error, as_written, kind)
        raise ConfigError(str(file), ".".join(filter(None, (at, key))), problem) from None


def refuse_first(file: Path, problems: Iterable[Problem]) -> None:
    """Raise ConfigError for the first of the problems."""
    for key, problem in problems:
        raise ConfigError(str(file), key, problem)
