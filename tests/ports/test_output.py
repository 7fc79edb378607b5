"""What instances print and say: so much is logged and heard, and nothing that a terminal would obey."""

from __future__ import annotations

import logging

import pytest

from upwash.real.output import Output


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture(autouse=True)
def _log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="upwash.instance")


def test_what_is_printed_too_much_is_counted_and_told_once(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    output = Output("s", now_s=clock)
    output.add(b"x" * 900 + b"\n" + b"word\n" * 100_000)
    logged = len(caplog.messages)
    assert 100 < logged < 1000
    output.add(b"still too much\n")
    assert len(caplog.messages) == logged
    clock.now_s = 1.0
    output.add(b"later\n")
    assert caplog.messages[logged:] == [
        f"s: {100_001 - logged + 1} lines left out, as it prints too much",
        "s: later",
    ]


def test_a_crash_is_explained_by_the_last_words_also_where_they_were_left_out(
    caplog: pytest.LogCaptureFixture,
) -> None:
    output = Output("s", now_s=Clock())
    output.add(b"word\n" * 100_000 + b"KeyError: 'model'")
    assert output.explain(1) == "ended with code 1: word / word / word / word / KeyError: 'model'"
    assert "lines left out" in caplog.messages[-1]


def test_no_control_character_of_a_service_reaches_the_log(caplog: pytest.LogCaptureFixture) -> None:
    output = Output("s", now_s=Clock())
    output.add("\x1b[2J\x1b]0;title\x07done\x85\u2028forged line\u202e\n".encode())
    (said,) = caplog.messages
    assert said.isprintable()
    assert "done" in said
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize(("code", "how"), [(-9, "killed by SIGKILL"), (-99999, "killed by signal 99999")])
def test_a_signal_that_there_is_not_is_told_by_its_number(code: int, how: str) -> None:
    assert Output("s").explain(code) == how
