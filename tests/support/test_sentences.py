"""Sentences for a person, on a terminal and elsewhere."""

from __future__ import annotations

import io

from rich.console import Console

from upwash.support.sentences import say

SENTENCE = "two drones were asked for and three of them came to the field"


def said(*, terminal: bool, indent: int = 0) -> list[str]:
    console = Console(file=io.StringIO(), width=24, force_terminal=terminal, color_system=None)
    with console.capture() as captured:
        say(SENTENCE, console, indent=indent)
    return captured.get().splitlines()


def test_a_terminal_breaks_them_between_words() -> None:
    lines = said(terminal=True)
    assert len(lines) > 1
    assert max(map(len, lines)) <= 24
    assert " ".join(lines).split() == SENTENCE.split()


def test_a_sentence_that_is_continued_stays_indented() -> None:
    assert all(line.startswith("    ") for line in said(terminal=True, indent=4))


def test_elsewhere_each_is_one_line() -> None:
    assert said(terminal=False) == [SENTENCE]
    assert said(terminal=False, indent=4) == [f"    {SENTENCE}"]
