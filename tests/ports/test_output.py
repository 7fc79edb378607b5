"""What instances print and say: so much is logged and heard, and nothing that a terminal would obey."""

from __future__ import annotations

import asyncio
import logging

import pytest

from upwash.real.instances.output import InstanceOutput, chunks_of
from upwash.sim.loop import run_virtually


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
    output = InstanceOutput("s", now_s=clock)
    output.add(b"x" * 900 + b"\n" + b"word\n" * 100_000)
    logged = len(caplog.messages)
    assert 100 < logged < 1000
    output.add(b"still too much\n")
    assert len(caplog.messages) == logged
    clock.now_s = 1.0
    output.add(b"later\n")
    left_out = len(b"word\n") * (100_000 - (logged - 1)) + len(b"still too much\n")
    assert caplog.messages[logged:] == [f"s: {left_out} bytes left out, as it prints too much", "s: later"]


def test_a_line_without_end_is_logged_in_pieces_and_the_rest_counted(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock = Clock()
    output = InstanceOutput("s", now_s=clock)
    for _ in range(2000):
        output.add(b"x" * 700)
    logged = caplog.messages[:]
    assert logged
    assert set(logged) == {f"s: {'x' * 1000}"}
    clock.now_s = 10.0
    output.add(b"end\n")
    left_out = 1_400_000 - 1000 * len(logged)
    assert caplog.messages[len(logged)] == f"s: {left_out} bytes left out, as it prints too much"


def test_at_the_end_the_last_words_are_logged_and_what_was_left_out_is_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    output = InstanceOutput("s", now_s=Clock())
    output.add(b"a prompt: ")
    output.close()
    assert caplog.messages == ["s: a prompt:"]
    output.add(b"word\n" * 100_000)
    output.close()
    assert "bytes left out" in caplog.messages[-1]


def test_what_was_left_out_on_the_way_counts_too(caplog: pytest.LogCaptureFixture) -> None:
    InstanceOutput("s", now_s=Clock()).add(b"word\n", left_out=7)
    assert caplog.messages == ["s: 7 bytes left out, as it prints too much", "s: word"]


@pytest.mark.parametrize("printed", [b"", b"word\n", b"10%\r"], ids=str)
def test_a_chatty_service_is_read_as_fast_as_it_prints(
    printed: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL, logger="upwash.instance")

    async def passed_s() -> float:
        loop = asyncio.get_running_loop()
        prints = asyncio.StreamReader()
        output, chunk, read_bytes = InstanceOutput("s"), (printed or b"x") * 10_000, 0
        for _ in range(100):
            prints.feed_data(chunk)
        prints.feed_eof()
        began_s = loop.time()
        async for each in chunks_of(prints):
            output.add(each)
            read_bytes += len(each)
        assert read_bytes == 100 * len(chunk)
        return loop.time() - began_s

    assert run_virtually(passed_s()) == 0.0


def test_a_crash_is_explained_by_the_last_words_also_where_they_were_left_out(
    caplog: pytest.LogCaptureFixture,
) -> None:
    output = InstanceOutput("s", now_s=Clock())
    output.add(b"word\n" * 100_000 + b"KeyError: 'model'")
    assert output.explain(1) == "ended with code 1: word / word / word / word / KeyError: 'model'"
    assert "bytes left out" in caplog.messages[-1]


def test_a_warning_of_a_service_is_a_warning_of_the_log(caplog: pytest.LogCaptureFixture) -> None:
    InstanceOutput("s").add(b"warning: no card\nno warning: fine\n")
    assert caplog.record_tuples == [
        ("upwash.instance", logging.WARNING, "s: warning: no card"),
        ("upwash.instance", logging.INFO, "s: no warning: fine"),
    ]


def test_no_control_character_of_a_service_reaches_the_log(caplog: pytest.LogCaptureFixture) -> None:
    output = InstanceOutput("s", now_s=Clock())
    output.add("\x1b[2J\x1b]0;title\x07done\x85\u2028forged line\u202e\n".encode())
    (said,) = caplog.messages
    assert said.isprintable()
    assert "done" in said
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize(("code", "how"), [(-9, "killed by SIGKILL"), (-99999, "killed by signal 99999")])
def test_a_signal_that_there_is_not_is_told_by_its_number(code: int, how: str) -> None:
    assert InstanceOutput("s").explain(code) == how
