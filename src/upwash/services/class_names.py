"""The names of classes that a network's metadata has."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import islice

MOST_LABELS = 100_000
_MOST_NAMES_LETTERS = 2_000_000
_NAME = re.compile(r"""\s*(?:["']?(\d{1,6})["']?\s*:\s*)?('(?:[^'\\\n]|\\.)*'|"(?:[^"\\\n]|\\.)*")\s*(,|$)""")


def parse_names(text: str) -> list[str]:
    """The names of classes, as {0: 'person', 1: "cat"}, ['person', "cat"] or in JSON; raises ValueError."""
    text = text.strip()
    if len(text) > _MOST_NAMES_LETTERS or text[:1] + text[-1:] not in ("{}", "[]"):
        raise ValueError("no list of names")
    found = islice(_names_in(text[1:-1]), MOST_LABELS + 1)
    numbered = [(len(text) if not index else int(index), name) for index, name in found]
    names = [name.strip() for _, name in sorted(numbered, key=lambda item: item[0])]
    if text[0] == "{" and sorted(index for index, _ in numbered) != list(range(len(numbered))):
        raise ValueError(f"its numbers are not those from 0 to {len(numbered) - 1}")
    if not 0 < len(names) <= MOST_LABELS or not all(names):
        raise ValueError("an empty name, no names or too many")
    return names


def _names_in(text: str) -> Iterator[tuple[str | None, str]]:
    at = 0
    text = text.rstrip()
    while at < len(text):
        if (match := _NAME.match(text, at)) is None:
            raise ValueError(f"no name at letter {at + 2}")
        try:
            yield match[1], ast.literal_eval(match[2])  # a string alone
        except SyntaxError as error:
            raise ValueError(f"no name at letter {at + 2}: {error.msg}") from error
        at = match.end()
