"""The client's words for labels, with a severity and a colour: a CSV file that a user writes."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from upwash.errors import ConfigError
from upwash.eventlog.objects import noun_of
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
    rows, words, lines = _rows(file), dict[str, Word](), dict[str, int]()
    line, header = next(rows, (1, []))

    def require(is_so: bool, problem: str) -> None:
        if not is_so:
            raise _problem(file, line, problem)

    columns = [cell.lower() for cell in header]
    found = printable(", ".join(header), _SHOWN) or "nothing"
    are_known = set(columns) <= set(_COLUMNS) and len(set(columns)) == len(columns)
    problem = f"the columns are {found}: name them label, name, severity and colour"
    require("label" in columns and are_known, problem)
    for line, row in rows:
        counts = f"{len(row)} values for {len(columns)} columns"
        require(len(row) == len(columns), f"{counts}: write one each, in quotes if it has commas")
        facts = dict(zip(columns, row, strict=True))
        label, colour = facts["label"], facts.get("colour", "")
        again = f"the label {printable(label, _SHOWN)!r} is on line {lines.get(label)} too"
        require(label not in words, f"{again}: leave one of them out")
        require(bool(label), "no label: write it as the findings have it")
        for name, value in facts.items():
            problem = f"the {name} is longer than {_LONGEST} characters: shorten it"
            require(len(value) <= _LONGEST, problem)
        odd = f"{printable(colour, _SHOWN)!r} is no colour: write #rrggbb, such as {LIGHT.alarm}"
        require(not colour or bool(_COLOUR.fullmatch(colour)), odd)
        words[label] = Word(
            printable(facts.get("name", "")) or noun_of(label),
            printable(facts.get("severity", "")),
            colour.lower() or LIGHT.alarm,
        )
        lines[label] = line
    require(bool(words), "no rows: add one for each label")
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


def _problem(file: Path, line: int, problem: str) -> ConfigError:
    return ConfigError(str(file), f"line {line}", problem)
