from __future__ import annotations

import pytest

from upwash.core.geo import Circle, Measured, Position
from upwash.core.knowledge.coverage import Coverage, MeasuredPlace
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.operation import Operation
from upwash.core.policies.policy import LocationAware
from upwash.core.selection.commands import Effect
from upwash.core.selection.events import (
    CheckAnswered,
    NetworkGone,
    ProbeUnanswered,
    Reached,
    SelectionEvent,
    ServerUnusable,
    Tick,
)
from upwash.core.selection.recovery import Probing
from upwash.core.selection.selection import Selection
from upwash.core.selection.settings import SelectionSettings
from upwash.eventlog.schema import PlaceMeasured

HEAVY = Operation("detector", "process_photo", "heavy")
LIGHT = Operation("detector", "process_photo", "light")
HERE = Position(100.0, 0.0)
LOCAL_S, REMOTE_S = 10.0, 1.0
SAME_M, NEAR_M, MOST_PLACES = 8.0, 12.0, 5_000


def coverage() -> Coverage:
    return Coverage({"lte": ()})


def estimates(known: Coverage) -> Estimates:
    """Heavy and light calls, as slow on the drone as each other, and fast on the servers lte and s1."""
    beliefs = Beliefs(3.0, 1.0, {HEAVY: REMOTE_S, LIGHT: REMOTE_S})
    return Estimates(
        local_s={HEAVY: LOCAL_S, LIGHT: LOCAL_S}, servers={"lte": beliefs, "s1": beliefs}, coverage=known
    )


def east_of_here(by_m: float) -> Position:
    return Position(HERE.east_m + by_m, HERE.north_m, 30.0)


def test_what_is_measured_at_a_place_is_believed_around_it() -> None:
    known = coverage()
    place = known.asked("lte", HERE, answered=True)
    assert known.at("lte", east_of_here(NEAR_M)) is place
    assert known.at("lte", east_of_here(-NEAR_M)) is place
    assert known.at("lte", east_of_here(NEAR_M + 0.1)) is None
    for east_m, north_m in ((0.0, NEAR_M), (0.0, -NEAR_M), (8.0, -8.0), (-8.0, 8.0)):
        assert known.at("lte", Position(HERE.east_m + east_m, north_m)) is place
        assert known.at("lte", Position(HERE.east_m + 1.1 * east_m, 1.1 * north_m)) is None
    assert known.at("s1", HERE) is None


def test_the_nearest_place_counts() -> None:
    known = coverage()
    first = known.asked("lte", HERE, answered=True)
    second = known.asked("lte", east_of_here(SAME_M + 1.0), answered=False)
    assert known.at("lte", east_of_here(4.0)) is first
    assert known.at("lte", east_of_here(5.0)) is second
    assert known.asked("lte", east_of_here(1.0), answered=True) is first
    assert (first.tried, first.answered, second.tried, second.answered) == (2, 2, 1, 0)


def test_what_earlier_flights_measured_is_known() -> None:
    place = MeasuredPlace(HERE, tried=2, answered=1)
    assert Coverage({"lte": [place]}).at("lte", east_of_here(5.0)) is place


def test_a_place_is_the_same_within_8_m_and_its_latest_call_is_new() -> None:
    known = coverage()
    first = known.asked("lte", HERE, answered=True)
    first.flights_ago = 5
    assert known.asked("lte", east_of_here(SAME_M), answered=False) is first
    assert first.flights_ago == 0
    assert known.asked("lte", east_of_here(SAME_M + 0.5), answered=False) is not first


def test_a_call_comes_to_the_mean_of_the_last_three_there() -> None:
    known = coverage()
    place = known.asked("lte", HERE, answered=True)
    for came_to_s in (9.0, 1.0, 2.0, 3.0):
        place.note(HEAVY, came_to_s)
    believed = estimates(known)
    assert believed.remote_s("lte", HEAVY, HERE) == pytest.approx(2.0)
    assert believed.remote_s("lte", HEAVY, east_of_here(50.0)) == REMOTE_S
    assert believed.remote_s("s1", HEAVY, HERE) == REMOTE_S


def test_where_a_server_does_not_answer_a_call_is_no_faster_than_on_the_drone() -> None:
    known = coverage()
    known.asked("lte", HERE, answered=False)
    believed = estimates(known)
    assert believed.remote_s("lte", HEAVY, HERE) == LOCAL_S
    assert believed.mean_call_s("lte", HERE) == believed.mean_call_s()
    assert believed.mean_call_s("lte", east_of_here(50.0)) == REMOTE_S


def test_an_answered_check_says_that_the_server_is_there_and_nothing_of_its_delay() -> None:
    known = coverage()
    known.asked("lte", HERE, answered=True)
    assert estimates(known).remote_s("lte", HEAVY, HERE) == REMOTE_S


def test_where_no_place_is_named_that_of_the_drone_counts() -> None:
    known = coverage()
    known.asked("lte", HERE, answered=False)
    believed = estimates(known)
    assert believed.remote_s("lte", HEAVY) == REMOTE_S
    assert believed.locate(HERE)
    assert believed.remote_s("lte", HEAVY) == LOCAL_S
    assert not believed.locate(east_of_here(1.0))
    assert believed.locate(east_of_here(50.0))


def test_goodput_is_told_by_calls_that_carry_something() -> None:
    place = coverage().asked("lte", HERE, answered=True)
    place.carry(100, 0.5)
    assert place.goodput_bit_s is None
    place.carry(500_000, 0.5)
    assert place.goodput_bit_s == pytest.approx(8e6)
    place.carry(500_000, 1.5)
    assert place.goodput_bit_s == pytest.approx(4e6)


def test_the_places_of_a_server_are_bounded() -> None:
    known = coverage()
    for number in range(MOST_PLACES + 10):
        known.asked("lte", Position(0.0, 10.0 * number), answered=True)
    assert len(list(known.places("lte"))) == MOST_PLACES
    assert known.at("lte", Position(0.0, 10.0 * (MOST_PLACES + 9))) is not None
    assert known.at("lte", Position(0.0, -10.0)) is None


@pytest.mark.parametrize(
    ("answered", "tried", "reached"), [(0, 0, True), (1, 1, True), (1, 2, True), (1, 3, False), (0, 1, False)]
)
def test_a_place_is_reached_where_half_of_the_calls_are_answered(
    answered: int, tried: int, *, reached: bool
) -> None:
    assert MeasuredPlace(HERE, tried, answered).reached is reached


@pytest.mark.parametrize(
    ("bits", "transfer_s", "goodput_bit_s"), [(0.0, 2.0, None), (8.0, 0.0, None), (0.5, 0.25, 2.0)]
)
def test_a_place_has_a_goodput_where_bits_took_time(
    bits: float, transfer_s: float, goodput_bit_s: float | None
) -> None:
    assert MeasuredPlace(HERE, bits=bits, transfer_s=transfer_s).goodput_bit_s == goodput_bit_s


def test_the_goodput_of_a_place_is_that_of_large_calls() -> None:
    place = MeasuredPlace(HERE)
    place.carry(9_999, 1.0)
    assert place.goodput_bit_s is None
    place.carry(10_000, 2.0)
    place.carry(30_000, 3.0)
    assert place.goodput_bit_s == 8 * 40_000 / 5.0


# --- what the drone's machine measures ----------------------------------------------------------------------


def mapping(*, has_range: bool = False) -> Selection:
    """The machine with lte selected by check 1 at 0 s; a server is measured unless it has a range."""
    believed = estimates(Coverage({"s1": ()} if has_range else {"lte": ()}))
    areas = {"lte": Circle(HERE, 1000.0)} if has_range else {"lte": Measured()}
    settings = SelectionSettings(probing=Probing())
    machine = Selection(areas, estimates=believed, policy=LocationAware(), settings=settings)
    machine.handle(Tick(), now_s=0.0, position=HERE)
    return machine


def mapped(effects: list[Effect]) -> list[tuple[int, int]]:
    """How many calls and questions were tried, and answered, at the places that are to be logged."""
    return [(each.place.tried, each.place.answered) for each in effects if isinstance(each, PlaceMeasured)]


@pytest.mark.parametrize(
    ("event", "counted"),
    [
        (CheckAnswered(1, running=True), [(1, 1)]),
        (ServerUnusable(1, "no answer", unreached=True), [(1, 0)]),
        (ServerUnusable(1, "no slot"), []),  # it answered
        (NetworkGone(1, "no carrier"), [(1, 0)]),
        (CheckAnswered(9, running=True), []),
        (ProbeUnanswered(1), []),  # it is not probed
    ],
)
def test_whether_a_server_without_a_range_answers_is_measured(
    event: SelectionEvent, counted: list[tuple[int, int]]
) -> None:
    assert mapped(mapping().handle(event, now_s=2.0, position=HERE)) == counted
    assert mapped(mapping(has_range=True).handle(event, now_s=2.0, position=HERE)) == []


def test_a_probe_without_an_answer_counts_once_for_each_place() -> None:
    counts = []
    for machine in (mapping(), mapping(has_range=True)):
        machine.handle(NetworkGone(1, "no carrier"), now_s=2.0, position=HERE)
        for now_s, east_m in ((3.0, 0.0), (4.0, 1.0), (5.0, 50.0), (6.0, 51.0), (7.0, 0.0)):
            effects = machine.handle(ProbeUnanswered(2), now_s=now_s, position=east_of_here(east_m))
            counts.append(mapped(effects))
    assert counts == [[(2, 0)], [], [(1, 0)], [], [(3, 0)], *[[]] * 5]


def test_a_call_is_measured_where_it_was_made_and_a_failed_one_costs_the_drones_own_too() -> None:
    machine = mapping()
    machine.handle(CheckAnswered(1, running=True), now_s=2.0, position=HERE)
    there = east_of_here(500.0)
    answered = Reached("lte", there, True, HEAVY, 2.0, 500_000)
    ((tried, right),) = mapped(machine.handle(answered, now_s=5.0, position=HERE))
    assert (tried, right) == (1, 1)
    known = machine.estimates.coverage
    assert known is not None
    place = known.at("lte", there)
    assert place is not None and (place.call_s(HEAVY), place.goodput_bit_s) == (2.0, 2e6)
    machine.handle(Reached("lte", there, False, HEAVY, 3.0, 500_000), now_s=9.0, position=HERE)
    assert place.call_s(HEAVY) == (2.0 + 3.0 + LOCAL_S) / 2
    assert place.goodput_bit_s == 2e6, "a failed call carried nothing"
    without = Selection(
        {"lte": Circle(HERE, 1000.0)},
        estimates=Estimates(local_s={HEAVY: LOCAL_S}, servers={"lte": Beliefs(3.0, 1.0, {HEAVY: REMOTE_S})}),
        policy=LocationAware(),
    )
    assert mapped(without.handle(answered, now_s=5.0, position=HERE)) == []
