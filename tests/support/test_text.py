"""Text from elsewhere: nothing of it moves a cursor, forges a line or hides what stands there."""

from __future__ import annotations

import json

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.support.text import by_name, escaped, escaped_lines, json_line, lasting, printable, worded


@pytest.mark.parametrize(
    ("raw", "shown"),
    [
        ("plain, and ünïcödé 日本", "plain, and ünïcödé 日本"),
        ("\x1b[2J", r"\x1b[2J"),
        ("\x9b31m", r"\x9b31m"),
        ("one\r\ntwo", r"one\r\ntwo"),
        ("\u202egnp.exe", r"\u202egnp.exe"),
        ("a\u2028b", r"a\u2028b"),
        ("\x00\x7f", r"\x00\x7f"),
        ("\udc80", r"\udc80"),
        ("\U000e0041", r"\U000e0041"),
    ],
)
def test_what_is_not_printed_becomes_an_escape(raw: str, shown: str) -> None:
    assert escaped(raw) == shown


@given(st.text(), st.integers(1, 50))
def test_a_printable_text_is_one_line_of_bounded_length(text: str, most: int) -> None:
    shown = printable(text, most)
    assert shown.isprintable()
    assert len(shown) <= most
    assert printable(shown, most) == shown


def test_what_is_cut_off_leaves_a_mark() -> None:
    assert printable("abcdef", 4) == "abc…"
    assert printable("abcd", 4) == "abcd"


def test_the_ends_of_lines_may_stay() -> None:
    assert escaped_lines("one\n\x1btwo") == "one\n\\x1btwo"


@given(
    st.recursive(st.text() | st.integers(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner))
)
def test_a_line_of_json_reads_the_same_and_shows_nothing_that_is_not_printed(value: object) -> None:
    line = msgspec.json.encode(value)
    assert json.loads(json_line(line)) == json.loads(line)
    assert json_line(line).decode().isprintable()


class Wordless(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no words")


@pytest.mark.parametrize(
    ("error", "words"),
    [(KeyError("s1"), "KeyError: 's1'"), (SystemExit(), "SystemExit"), (Wordless("said"), "Wordless")],
)
def test_an_error_is_worded_whatever_its_own_code_does(error: BaseException, words: str) -> None:
    assert worded(error) == words


def test_names_are_sorted_as_people_count() -> None:
    names = ["pole10", "pole2", "s", "pole2b", "pole02", "2", "10", "pole" + "9" * 9000]
    assert sorted(names, key=by_name) == ["2", "10", "pole02", "pole2", "pole2b", "pole10", names[-1], "s"]


@pytest.mark.parametrize(
    ("seconds", "margin_s", "words"),
    [
        (15.44, None, "15.4 s"),
        (-0.01, None, "0.0 s"),
        (96.6, None, "1:36"),
        (-226.0, None, "-3:46"),
        (3723.0, None, "1:02:03"),
        (1482.7, 1.14, "24:42 ± 1.1 s"),
        (5.0, 0.25, "5.0 ± 0.2 s"),
        (1482.7, float("inf"), "24:42"),  # of one mission
        (1482.7, 1e-12, "24:42"),  # of equal missions
    ],
)
def test_a_duration_is_in_minutes_and_seconds_from_a_minute_on(
    seconds: float, margin_s: float | None, words: str
) -> None:
    assert lasting(seconds, margin_s) == words
