"""Which messages are news: on links that repeat and reorder, and where the numbers are not the vehicle's."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator
from itertools import count
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.real.mavlink.numbering import Numbering

Numbers = Callable[[str, int], int]  # the number of the so-manieth message of that kind
PERIODS = {
    "HEARTBEAT": 10,
    "GLOBAL_POSITION_INT": 10,
    "ATTITUDE": 25,
    "SYS_STATUS": 100,
}  # hundredths of a second


def message(kind: str, boot_ms: int, mode: int = 4) -> Any:
    match kind:
        case "HEARTBEAT":
            return mavlink.MAVLink_heartbeat_message(2, 3, 81, mode, 4, 3)
        case "GLOBAL_POSITION_INT":
            return mavlink.MAVLink_global_position_int_message(boot_ms, 1, 1, 1, 1, 0, 0, 0, 0)
        case "ATTITUDE":
            return mavlink.MAVLink_attitude_message(boot_ms, *(0.0,) * 6)
        case _:
            return mavlink.MAVLink_sys_status_message(*(0,) * 13)


def heard(made: Any, number: int) -> Any:
    codec = mavlink.MAVLink(None, 1, 1)
    codec.seq = number % 256
    (read,) = mavlink.MAVLink(None).parse_buffer(bytes(made.pack(codec)))
    return read


def stream(seconds: float, numbers: Numbers) -> Iterator[tuple[float, Any]]:
    """What a vehicle says, with the times at which it does."""
    total = count()
    for tick in range(round(seconds * 100)):
        for kind, period in PERIODS.items():
            if tick % period == 0:
                yield tick / 100, heard(message(kind, tick * 10), numbers(kind, next(total)))


def of_one_count(_kind: str, total: int) -> int:
    return total


def by_kind() -> Numbers:
    counts = {kind: count(index * 20) for index, kind in enumerate(PERIODS)}
    return lambda kind, _: next(counts[kind])


def taken(numbering: Numbering, said: Iterable[tuple[float, Any]]) -> list[tuple[float, str]]:
    """When a message of which kind was news."""
    return [(at_s, each.get_type()) for at_s, each in said if numbering.is_news(each, at_s, linked=True)]


def share(taken_since: list[tuple[float, str]], kind: str, since_s: float, until_s: float) -> float:
    came = sum(each == kind and since_s <= at_s for at_s, each in taken_since)
    return came / ((until_s - since_s) * 100 / PERIODS[kind])


@pytest.mark.parametrize(
    "numbers",
    [
        pytest.param(lambda: of_one_count, id="of one count"),
        pytest.param(lambda: lambda _, total: 2 * total, id="by two"),
        pytest.param(lambda: lambda *_: 0, id="always 0"),
        pytest.param(lambda: lambda *_: 77, id="always the same"),
        pytest.param(by_kind, id="of each kind"),
        pytest.param(lambda: lambda _, total: -total, id="downwards"),
    ],
)
def test_whatever_the_numbers_are_no_kind_of_message_is_missed_for_long(
    numbers: Callable[[], Numbers],
) -> None:
    news = taken(Numbering(), stream(30.0, numbers()))
    for kind in PERIODS:
        assert share(news, kind, 5.0, 30.0) > 0.95


@pytest.mark.parametrize("ahead", [1, 30, 64, 65, 100, 192, 230])
def test_two_streams_that_a_router_merges_are_both_heard(ahead: int) -> None:
    totals = count(), count(ahead)
    numbers = (lambda *_: next(totals[0])), (lambda *_: next(totals[1]))
    both = sorted((*stream(30.0, numbers[0]), *stream(30.0, numbers[1])), key=lambda each: each[0])
    news = taken(Numbering(), both)
    assert share(news, "HEARTBEAT", 5.0, 30.0) > 0.9


def test_a_few_messages_of_another_program_hide_none_of_the_vehicles() -> None:
    vehicle = list(stream(60.0, of_one_count))
    for ahead in range(0, 256, 5):
        strangers = [
            (at_s + 0.005, heard(message("SYS_STATUS", 0), number + ahead))
            for at_s, number in [(float(second), second) for second in range(60)]
        ]
        news = taken(Numbering(), sorted((*vehicle, *strangers), key=lambda each: each[0]))
        assert share(news, "GLOBAL_POSITION_INT", 0.0, 60.0) > 0.97


def lossy(said: Iterable[tuple[float, Any]], chance: random.Random, part: float) -> list[tuple[float, Any]]:
    """With that part lost, coming twice, and coming late by up to 50 ms."""
    came: list[tuple[float, Any]] = []
    for at_s, each in said:
        if chance.random() < part:
            continue
        late_s = [
            chance.uniform(0, 0.05) * (chance.random() < part) for _ in range(1 + (chance.random() < part))
        ]
        came.extend((at_s + each_s, each) for each_s in late_s)
    return sorted(came, key=lambda each: each[0])


@pytest.mark.parametrize("part", [0.05, 0.2, 0.4])
@pytest.mark.parametrize("seed", range(5))
def test_where_the_numbers_count_nothing_is_heard_twice_or_after_what_came_later(
    part: float, seed: int
) -> None:
    numbering = Numbering()
    newest = -1
    kept = list(stream(60.0, of_one_count))
    order = {id(each): place for place, (_, each) in enumerate(kept)}
    for at_s, each in lossy(kept, random.Random(seed), part):
        if numbering.is_news(each, at_s, linked=True):
            assert order[id(each)] > newest
            newest = order[id(each)]
    assert numbering.counts_up
    assert numbering.wrong_times == 0


@pytest.mark.parametrize("part", [0.5, 0.8, 0.9])
def test_a_link_that_loses_most_messages_still_counts_and_knows_the_share(part: float) -> None:
    numbering, chance = Numbering(), random.Random(5)
    for at_s, each in stream(120.0, of_one_count):
        if chance.random() >= part:
            assert numbering.is_news(each, at_s, linked=True)
    assert numbering.received_share == pytest.approx(1 - part, abs=0.15)


def test_an_old_mode_is_no_news_and_after_a_silence_everything_is() -> None:
    numbering = Numbering()
    for number in range(20, 60):
        assert numbering.is_news(heard(message("ATTITUDE", number), number), number / 10, linked=True)
    old = heard(message("HEARTBEAT", 0, mode=5), 30)
    assert not numbering.is_news(old, 6.0, linked=True)
    assert numbering.is_news(old, 9.0, linked=False)


def test_without_numbers_what_has_a_time_since_boot_is_judged_by_that() -> None:
    numbering = Numbering()
    taken(numbering, stream(10.0, lambda *_: 0))
    assert not numbering.counts_up
    assert not numbering.is_news(heard(message("ATTITUDE", 9_000), 0), 10.0, linked=True)
    assert numbering.is_news(heard(message("ATTITUDE", 10_010), 0), 10.0, linked=True)
    assert numbering.is_news(heard(message("ATTITUDE", 500), 0), 10.1, linked=True), (
        "the vehicle was restarted"
    )


def test_numbers_that_count_again_are_believed_again() -> None:
    numbering = Numbering()
    taken(numbering, stream(10.0, lambda *_: 0))
    for at_s, each in stream(10.0, of_one_count):
        numbering.is_news(each, 10.0 + at_s, linked=True)
    assert numbering.counts_up
