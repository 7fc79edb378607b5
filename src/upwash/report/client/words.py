"""The client's words for labels, with a severity and a colour: a CSV file that a user writes."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from upwash.errors import ConfigError
from upwash.report.numbering import noun_of
from upwash.report.palette import LIGHT
from upwash.support.input_files import read_named_text
from upwash.support.text import printable

_COLUMNS = ("label", "name", "severity", "colour")
_COLOUR = re.compile(r"#[0-9a-fA-F]{6}")
_MOST_BYTES = 1_000_000
_MOST_ROWS = 1000
_LONGEST = 60  # characters of a cell
_SHOWN = 40  # characters, in a message


@dataclass(frozen=True, slots=True)
class Word:
    """What the client calls a label, how severe that is in the client's words, and its colour on the map."""

    name: str
    severity: str = ""
    colour: str = LIGHT.alarm


@dataclass(frozen=True, slots=True)
class Words:
    """The client's words by label; a label without one has its own name."""

    by_label: Mapping[str, Word]

    def of(self, label: str) -> Word:
        """The word for that label."""
        return self.by_label.get(label) or Word(noun_of(label))

    @property
    def severities(self) -> Sequence[str]:
        """All severities, in the order of the file, the worst first."""
        return list(dict.fromkeys(word.severity for word in self.by_label.values() if word.severity))


NO_WORDS = Words({})


def read_words(file: Path) -> Words:
    """The words of a CSV file with the columns label, name, severity and colour; only label is required.

    A semicolon may separate cells, as spreadsheet programs of some languages write them. Raises ConfigError, which
    names the line and what to do.
    """
    rows = _rows(file)
    line, header = next(rows, (1, []))
    columns = [cell.lower() for cell in header]
    if "label" not in columns or not set(columns) <= set(_COLUMNS) or len(set(columns)) < len(columns):
        found = printable(", ".join(header), _SHOWN) or "nothing"
        raise _problem(file, line, f"the columns are {found}: name them label, name, severity and colour")
    words: dict[str, Word] = {}
    lines: dict[str, int] = {}
    for line, row in rows:
        if len(row) != len(columns):
            problem = (
                f"{len(row)} values for {len(columns)} columns: write one each, in quotes if it has commas"
            )
            raise _problem(file, line, problem)
        facts = dict(zip(columns, row, strict=True))
        label = facts["label"]
        if label in words:
            problem = (
                f"the label {printable(label, _SHOWN)!r} is on line {lines[label]} too: leave one of them out"
            )
            raise _problem(file, line, problem)
        words[label], lines[label] = _word(file, line, facts), line
    if not words:
        raise _problem(file, line, "no rows: add one for each label")
    return Words(words)


def _rows(file: Path) -> Iterator[tuple[int, list[str]]]:
    """The number of each line that is not blank, and its cells."""
    text = read_named_text(file, most_bytes=_MOST_BYTES)
    first = text.partition("\n")[0]
    delimiter = ";" if ";" in first and "," not in first else ","
    reader = csv.reader(io.StringIO(text), delimiter=delimiter, strict=True)
    count = 0
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells):
                count += 1
                if count > _MOST_ROWS + 1:
                    raise _problem(file, reader.line_num, f"more than {_MOST_ROWS} labels: leave some out")
                yield reader.line_num, cells
    except csv.Error as error:
        raise _problem(file, reader.line_num, f"{error}: close each quotation mark") from None


def _word(file: Path, line: int, facts: Mapping[str, str]) -> Word:
    label, colour = facts["label"], facts.get("colour", "")
    if not label:
        raise _problem(file, line, "no label: write it as the findings have it")
    for name, value in facts.items():
        if len(value) > _LONGEST:
            raise _problem(file, line, f"the {name} is longer than {_LONGEST} characters: shorten it")
    if colour and not _COLOUR.fullmatch(colour):
        problem = f"{printable(colour, _SHOWN)!r} is no colour: write #rrggbb, such as {LIGHT.alarm}"
        raise _problem(file, line, problem)
    return Word(
        printable(facts.get("name", "")) or noun_of(label),
        printable(facts.get("severity", "")),
        colour.lower() or LIGHT.alarm,
    )


def _problem(file: Path, line: int, problem: str) -> ConfigError:
    return ConfigError(str(file), f"line {line}", problem)
