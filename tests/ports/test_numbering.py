"""Which messages are news: on links that repeat and reorder, and where the numbers are not the vehicle's."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator
from itertools import count
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.real.mavlink.numbering import BootClock, Numbering

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


# --- step by step -------------------------------------------------------------------------------------------

TICK_S = 1 / 16  # which floats hold exactly


@pytest.mark.parametrize(
    ("numbers", "last_is_news"),
    [
        ([100, 101], True),
        ([100, 108, 101], False),  # a small step: what was left out is late
        ([100, 109, 101], True),  # a leap that no number has followed
        ([100, 109, 109], False),
        ([100, 36], False),  # late by 64
        ([100, 35], True),
        ([100, 150, 151, 101], False),  # a leap that the next number follows: what was left out is lost
        ([100, 150, 214, 213], False),
        ([100, 150, 215, 101], True),
        ([0, 40, 50, 10], False),
        ([250, 2, 251], False),
        ([100, 200, 8, 250], False),
        ([100, 101, 40], False),
    ],
)
def test_a_number_is_ahead_late_or_a_strangers(numbers: list[int], *, last_is_news: bool) -> None:
    numbering = Numbering()
    *before, last = (
        numbering.is_news(heard(message("ATTITUDE", boot_ms), number), 0.0, linked=True)
        for boot_ms, number in enumerate(numbers)
    )
    assert before == [True] * len(before)
    assert last == last_is_news


def test_what_is_said_and_a_battery_are_as_good_when_they_come_late_but_not_twice() -> None:
    numbering = Numbering()
    for number in range(10, 20):
        numbering.is_news(heard(message("ATTITUDE", number), number), number / 100, linked=True)
    text = mavlink.MAVLink_statustext_message(4, b"Battery Failsafe")
    battery = mavlink.MAVLink_battery_status_message(1, 0, 0, 0, [0] * 10, 0, 0, 0, 8)
    for late in text, battery:
        assert numbering.is_news(heard(late, 15), 0.3, linked=True)
        assert not numbering.is_news(heard(late, 15), 0.4, linked=True)
    assert not numbering.is_news(heard(message("HEARTBEAT", 0), 15), 0.5, linked=True)


def test_a_number_that_comes_again_is_a_copy_for_half_a_second() -> None:
    numbering = Numbering()
    for at_s, is_news in (0.0, True), (0.25, False), (0.5, False), (0.5 + TICK_S, True), (1.0, False):
        assert numbering.is_news(heard(message("SYS_STATUS", 0), 7), at_s, linked=True) == is_news


def judged(numbers: Iterable[int], numbering: Numbering | None = None, *, first_ms: int = 0) -> Numbering:
    """What becomes of messages that differ, with these numbers."""
    numbering = numbering or Numbering()
    for boot_ms, number in enumerate(numbers, first_ms):
        numbering.is_news(heard(message("ATTITUDE", boot_ms), number), 0.0, linked=True)
    return numbering


@pytest.mark.parametrize(
    ("numbers", "counts_up", "share"),
    [
        ([0] * 31, True, 1.0),  # not judged yet
        ([0] * 32, False, 1.0),
        (range(32), True, 1.0),
        (range(0, 64, 2), True, 32 / 63),
        ([*range(24), *[23] * 8], True, 1.0),
        ([*range(23), *[22] * 9], False, 1.0),
        ([*range(32), *(32 * pair + at for pair in range(1, 17) for at in (23, 31))], True, 1 / 16),
        (
            [*range(32), *(32 * pair + at for pair in range(1, 17) for at in (23, 31 + pair // 16))],
            False,
            1.0,
        ),
    ],
)
def test_numbers_count_if_they_are_as_many_as_the_messages_or_at_most_sixteen_times(
    numbers: Iterable[int], share: float, *, counts_up: bool
) -> None:
    numbering = judged(numbers)
    assert numbering.counts_up == counts_up
    assert numbering.received_share == pytest.approx(share)
    assert numbering.wrong_times == (not counts_up)


def test_judgements_that_numbers_do_not_count_are_counted_until_the_first_that_they_do() -> None:
    numbering = judged([0] * 96)
    assert numbering.wrong_times == 3
    assert judged([1, *range(1, 32)], numbering).wrong_times == 0
    assert numbering.counts_up


def test_a_silence_begins_the_judgement_anew() -> None:
    numbering = judged([0] * 31)
    assert numbering.is_news(heard(message("ATTITUDE", 900), 0), 9.0, linked=False)
    judged([0] * 30, numbering, first_ms=1000)
    assert numbering.counts_up
    judged([0], numbering, first_ms=2000)
    assert not numbering.counts_up


def test_where_numbers_do_not_count_a_time_since_boot_may_go_back_by_two_seconds_or_more() -> None:
    for later_ms, is_news in (1, True), (0, True), (-1, False), (-1999, False), (-2000, True):
        numbering = judged([0] * 32)
        first = mavlink.MAVLink_global_position_int_message(9_000, 1, 1, 1, 1, 0, 0, 0, 0)
        then = mavlink.MAVLink_global_position_int_message(9_000 + later_ms, 2, 2, 2, 2, 0, 0, 0, 0)
        assert numbering.is_news(heard(first, 0), 1.0, linked=True)
        assert numbering.is_news(heard(then, 0), 1.0, linked=True) == is_news
    assert numbering.is_news(heard(message("SYS_STATUS", 0), 0), 1.0, linked=True)
    assert numbering.is_news(heard(message("SYS_STATUS", 0), 0), 1.0, linked=True), "it has no time"
    assert numbering.is_news(heard(message("GLOBAL_POSITION_INT", 6_900), 0), 9.0, linked=False)


@pytest.mark.parametrize(
    ("others", "after_s", "is_news"),
    [(0, 0.5, False), (0, 0.5 + TICK_S, True), (63, 0.0, False), (64, 0.0, True)],
)
def test_where_numbers_do_not_count_a_copy_is_known_for_half_a_second_among_64_messages(
    others: int, after_s: float, *, is_news: bool
) -> None:
    numbering = judged([0] * 32)
    first = heard(message("GLOBAL_POSITION_INT", 9_000), 0)
    assert numbering.is_news(first, 1.0, linked=True)
    judged([0] * others, numbering, first_ms=1000)
    assert numbering.is_news(first, 1.0 + after_s, linked=True) == is_news


# --- clocks -------------------------------------------------------------------------------------------------


def clock(*times: tuple[float, float]) -> tuple[list[bool], float]:
    """Whether each time since boot, with its arrival, shows a restart; and how much time has passed by the clock."""
    boot_clock = BootClock()
    return [boot_clock.take(boot_s, now_s) for boot_s, now_s in times], boot_clock.elapsed_s


@pytest.mark.parametrize(
    ("times", "restarts", "elapsed_s"),
    [
        ([(100.0, 0.0)], False, 0.0),
        ([(100.0, 0.0), (101.0, 1.0)], False, 1.0),
        ([(100.0, 0.0), (101.0, 1.0), (100.5, 1.5), (102.0, 2.0)], False, 2.0),  # out of order
        ([(100.0, 0.0), (99.0, 3.0), (103.0, 3.0)], False, 3.0),
        ([(100.0, 0.0), (99.0 - TICK_S, 3.0)], True, 3.0),
        ([(500.0, 0.0), (1.0, 0.5)], True, 0.5),  # after a pause
        ([(500.0, 0.0), (1.0, 0.25), (1.25, 0.5)], False, 0.5),
        ([(500.0, 0.0), (1.0, 0.25), (1.25, 0.5), (1.5, 0.75), (1.75, 1.0), (2.0, 1.25)], True, 1.25),
        ([(500.0, 9.0), (1.0, 9.25), (1.25, 9.5), (1.5, 9.75), (1.75, 10.0)], False, 1.0),
        ([(500.0, 0.0), (1.0, 0.25), (500.5, 0.5), (1.5, 0.75), (501.0, 1.0), (2.0, 1.25)], False, 1.75),
        ([(100.0, 0.0), (110.0, 0.25)], False, 10.0),  # a simulated clock may be as fast
        ([(100.0, 0.0), (110.0 + TICK_S, 0.25)], False, 0.25),
        ([(100.0, 0.0), (900.0, 0.25), (100.5, 0.5)], False, 0.75),  # one time that is not true
        ([(100.0, 8.0), (900.0, 8.25), (900.5, 8.75), (901.0, 9.25), (901.5, 9.5)], False, 1.75),
        ([(100.0, 8.0), (900.0, 8.25), (900.5, 8.75), (901.0, 9.0), (101.25, 9.25)], False, 2.25),
    ],
)
def test_a_clock_goes_on_starts_anew_or_is_not_believed(
    times: list[tuple[float, float]], restarts: bool, elapsed_s: float
) -> None:
    (*before, last), passed_s = clock(*times)
    assert not any(before)
    assert last == restarts
    assert passed_s == pytest.approx(elapsed_s)


def test_after_a_restart_time_passes_by_the_new_clock() -> None:
    restarts, elapsed_s = clock((500.0, 0.0), (1.0, 0.5), (2.0, 1.5), (3.0, 2.5))
    assert (restarts, elapsed_s) == ([False, True, False, False], 2.5)
