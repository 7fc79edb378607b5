"""A Darknet cfg as text: sections in the order of the file, each with its options."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from upwash.errors import ModelError
from upwash.support.input_files import text_of
from upwash.support.text import number_of, printable

T = TypeVar("T")

_MOST_BYTES = 1_000_000  # YOLOv3's has 8,300
_MOST_SECTIONS = 2000
_MOST_LISTED = 100  # numbers of one option; YOLOv3 has 9 anchors
_LONGEST_QUOTE = 60  # of the file, in a message


class Section:
    """One `[section]` and its options: `finish` refuses options that were not read."""

    def __init__(self, file: Path, name: str, line: int) -> None:
        self.name = name
        self.where = f"line {line} [{_quoted(name)}]"  # until the layer is known
        self._file = file
        self._options: dict[str, str] = {}
        self._read: set[str] = set()

    def add(self, name: str, value: str) -> None:
        """Takes one `name=value`; of several values Darknet reads the first."""
        self._options.setdefault(name, value)

    def error(self, problem: str) -> ModelError:
        """An error with the place in the cfg."""
        return ModelError(self._file, self.where, problem)

    def integer(self, name: str, default: int | None = None, *, least: int, most: int = 100_000) -> int:
        """A whole number; required without a default."""

        def read(text: str) -> int:
            number = _integer(text)
            if not least <= number <= most:
                raise ValueError
            return number

        return self._value(name, read, default, f"a whole number from {least} to {most}")

    def integers(self, name: str) -> tuple[int, ...]:
        """Whole numbers, separated by commas."""

        def read(text: str) -> tuple[int, ...]:
            return tuple(map(_integer, _listed(text)))

        return self._value(name, read, None, f"whole numbers, at most {_MOST_LISTED}")

    def sizes(self, name: str) -> tuple[tuple[float, float], ...]:
        """Pairs of width and height, all above 0."""

        def read(text: str) -> tuple[tuple[float, float], ...]:
            numbers = [number_of(number) for number in _listed(text.rstrip(","))]
            if not all(0 < number < 1e6 for number in numbers):
                raise ValueError
            return tuple(zip(numbers[::2], numbers[1::2], strict=True))

        return self._value(
            name, read, None, f"pairs of width and height, all above 0, at most {_MOST_LISTED // 2}"
        )

    def choice(self, name: str, default: str | None, allowed: tuple[str, ...]) -> str:
        """One of the allowed words; required without a default."""

        def read(text: str) -> str:
            if text not in allowed:
                raise ValueError
            return text

        return self._value(name, read, default, f"one of {', '.join(allowed)}")

    def has(self, name: str) -> bool:
        """Whether the file gives the option."""
        return name in self._options

    def finish(self, *, ignored: frozenset[str]) -> None:
        """Raise ModelError for an option that was not read: it might change the network."""
        for name in self._options:
            if name not in self._read and name not in ignored:
                option = _quoted(f"{name}={self._options[name]}")
                raise self.error(f"unsupported option {option}: remove it if only training reads it")

    def _value(self, name: str, read: Callable[[str], T], default: T | None, expected: str) -> T:
        self._read.add(name)
        if name not in self._options:
            if default is None:
                raise self.error(f"{name} is missing: expected {expected}")
            return default
        try:
            return read(self._options[name])
        except ValueError:
            raise self.error(f"{_quoted(f'{name}={self._options[name]}')}: expected {expected}") from None


def read_sections(file: Path, content: bytes) -> list[Section]:
    """The sections of a cfg; raises ModelError with the line of an error."""
    if len(content) > _MOST_BYTES:
        raise ModelError(
            file, "", f"{len(content)} bytes are too many for a cfg: name the text file of layers"
        )
    try:
        text = text_of(content)
    except UnicodeDecodeError as error:
        raise ModelError(file, f"byte {error.start}", "not text: name the .cfg, not the weights") from None
    sections: list[Section] = []
    for number, line in _lines(text):
        if line.startswith("["):
            if not line.endswith("]") or len(sections) == _MOST_SECTIONS:
                raise ModelError(file, f"line {number}", f"not a section: {_quoted(line)}")
            sections.append(Section(file, line[1:-1], number))
            continue
        name, equals, value = line.partition("=")
        if not equals or not name or not value or not sections:
            raise ModelError(
                file, f"line {number}", f"expected [section] or option=value, found {_quoted(line)}"
            )
        sections[-1].add(name, value)
    return sections


def _listed(text: str) -> list[str]:
    numbers = text.split(",")
    if len(numbers) > _MOST_LISTED:
        raise ValueError
    return numbers


def _quoted(text: str) -> str:
    return printable(text, _LONGEST_QUOTE)


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """The lines with content and their numbers, without blanks, which Darknet ignores."""
    for number, line in enumerate(text.splitlines(), start=1):
        content = "".join(line.partition("#")[0].split())
        if content and not content.startswith(";"):
            yield number, content


def _integer(text: str) -> int:
    if not re.fullmatch(r"-?[0-9]{1,9}", text):
        raise ValueError
    return int(text)
