"""Forecasts of missions of rows, against times computed by hand, and the speed that is chosen by them."""

from __future__ import annotations

import math
from typing import Any

import pytest

from upwash.core.geo import Circle, Position, Waypoint
from upwash.core.planning.answering import ServerBelief
from upwash.core.planning.ground_speed import SpeedLimit, choose_speed
from upwash.core.planning.legs import Pace
from upwash.core.planning.row_forecast import RowForecast, RowMission, forecast_rows

ROW_S = 2 + 2 + (80 - 2 * 8) / 4  # 80 m at 4 m/s and 1 m/s²: each ramp takes 4 s for 8 m


def row(**known: Any) -> RowMission:
    """A photo every 20 m of 80 m; take-off 10 s, way home 16 s."""
    spots = [Position(20.0 * number, 0.0, 20.0) for number in range(5)]
    plan = [Waypoint(number, spot, row_end=spots[-1]) for number, spot in enumerate(spots)]
    mission: dict[str, Any] = {
        "plan": plan,
        "start": spots[0],
        "pace": Pace(1.0),
        "takeoff_s": 10.0,
        "home_s": lambda _: 16.0,
        "photo_s": 0.0,
        "local_s": 10.0,
    }
    return RowMission(**mission | known)


def server(radius_m: float, *, check_s: float = 8.0) -> dict[str, ServerBelief]:
    return {"s1": ServerBelief(Circle(Position(0.0, 0.0), radius_m), 1.0, check_s, 3.0)}


def flown(**known: Any) -> RowForecast:
    return forecast_rows(row(**known), 4.0)


def test_answers_that_take_no_time_leave_the_flight() -> None:
    found = flown(local_s=0.0)
    assert found.mission_s == pytest.approx(10 + 24 + 16)
    assert (found.stops, found.waited_s, found.keeps_up_m_s) == (0, 0, math.inf)


def test_a_drone_alone_answers_one_photo_after_the_other() -> None:
    found = flown()  # photos at 0, 7, 12, 17 and 24 s of the row, answers at 10, 20, 30, 40 and 50 s
    assert found.mission_s == pytest.approx(10 + 50 + 16)
    assert found.waited_s == pytest.approx(50 - 24)
    assert found.most_open == 3, "at 24 s two answers are there"
    assert found.photos_per_s == pytest.approx(4 / 20) and found.answers_per_s == pytest.approx(1 / 10)
    assert found.keeps_up_m_s == pytest.approx(20 / 10)


def test_with_too_many_open_answers_it_brakes_and_waits() -> None:
    found = flown(at_most=2)
    # It stops 8 m behind spots 1 to 3, at 28, 48 and 68 m: at 11, 20 and 29 s. The photos before are answered at 10,
    # 20 and 30 s, so it waits 1 s. At 68 m it sets off at 30 s, for 12 m: 2 * sqrt(12) s. The last answer: 50 s.
    assert (found.stops, found.most_open) == (4, 2)
    assert found.mission_s == pytest.approx(10 + 50 + 16)
    assert found.waited_s == pytest.approx(1 + 50 - 30 - 2 * math.sqrt(12))


@pytest.mark.parametrize(
    ("radius_m", "last_answer_s"),
    [
        (1000.0, 24 + 1),  # ready during the take-off, and each answer is there before the next photo
        # The last photo alone is out of range, 80 m away. The drone flies back 17 m, and brakes on the last 8 m. It
        # is in the range after 10 m, and has the answer after a check of 3 s and a call.
        (70.0, 24 + 4.25 + (4 - math.sqrt(14)) + 3 + 1),
        (50.0, 17 + 10 + 10),  # the photos at 60 and 80 m are, at 17 and 24 s
    ],
)
def test_a_server_answers_as_far_as_it_reaches(radius_m: float, last_answer_s: float) -> None:
    assert flown(servers=server(radius_m)).mission_s == pytest.approx(10 + last_answer_s + 16)


def test_a_photo_that_the_drone_computes_goes_to_a_server_that_gets_ready_too() -> None:
    found = flown(servers=server(1000.0, check_s=14.0), at_most=1)  # ready 4 s after the first photo
    assert found.waited_s == pytest.approx((4 + 1) + 0 + 1), (
        "in between it brakes for 4 s, and answers take 1"
    )


def test_a_server_out_of_range_gives_back_its_photo() -> None:
    found = flown(servers={"s1": ServerBelief(Circle(Position(0.0, 0.0), 30.0), 4.0, 8.0, 3.0)})
    # Photo 1 is sent at 7 s. The drone leaves the range at 30 m, at 9.5 s, and computes the photo itself, and the
    # others, the last one from 39.5 s on. At 24 s it flies back 53 m, is in the range 3 m before it rests there, and
    # after a check of 3 s the server answers the last one in 4 s.
    in_range_s = 24 + 53 / 4 + 4 - math.sqrt(2 * 3)
    assert found.mission_s == pytest.approx(10 + in_range_s + 3 + 4 + 16)


def test_a_demand_turns_it_back_and_it_flies_on_from_its_action() -> None:
    found = flown(servers=server(1000.0), demanding=frozenset({1}), action_s=5.0)
    # The answer is there at 8 s, at 24 m. It stops at 32 m, 4 s later, flies 12 m back, acts, and flies 60 m on.
    assert found.turns_back == 1
    assert found.mission_s == pytest.approx(10 + 8 + 4 + 2 * math.sqrt(12) + 5 + (60 / 4 + 4) + 1 + 16)


def test_a_demand_that_is_there_while_it_brakes_behind_the_last_photo_is_met() -> None:
    spots = [Position(0.0, 0.0), Position(20.0, 0.0)]
    plan = [Waypoint(number, spot, row_end=Position(30.0, 0.0)) for number, spot in enumerate(spots)]
    found = flown(plan=plan, start=spots[0], local_s=1.0, demanding=frozenset({1}), action_s=5.0)
    # The last photo is taken at 7 s; it rests 8 m behind at 11 s.
    assert found.turns_back == 1
    assert found.mission_s == pytest.approx(10 + 11 + 2 * math.sqrt(8) + 5 + 16)


def test_rows_are_told_apart() -> None:
    first = [Position(0.0, 0.0), Position(20.0, 0.0)]
    second = [Position(20.0, 10.0), Position(0.0, 10.0)]
    plan = [
        Waypoint(i, spot, row_end=row[1])
        for i, (row, spot) in enumerate((r, s) for r in (first, second) for s in r)
    ]
    found = forecast_rows(row(plan=plan, start=first[0], local_s=4.0), 4.0)
    assert [(one.row, one.photos, one.most_open) for one in found.rows] == [(0, 2, 1), (1, 2, 1)]
    assert [one.photos_per_s for one in found.rows] == [4 / 20, 4 / 20]
    assert found.mission_s == pytest.approx(10 + 2 * (20 / 4 + 4) + 2 * math.sqrt(10) + 4 + 16)


def test_a_row_behind_another_begins_at_rest_and_a_row_may_be_one_spot() -> None:
    spots = [Position(east_m, 0.0) for east_m in (0.0, 20.0, 40.0, 60.0, 80.0)]
    ends = [spots[1], spots[1], spots[3], spots[3], spots[4]]
    plan = [Waypoint(i, spot, row_end=end) for i, (spot, end) in enumerate(zip(spots, ends, strict=True))]
    found = forecast_rows(row(plan=plan, start=spots[0], local_s=1.0), 4.0)
    assert [one.photos for one in found.rows] == [2, 2, 1]
    assert found.mission_s == pytest.approx(10 + 4 * (20 / 4 + 4) + 1 + 16)


def chosen(*limits_m_s: float, **known: Any) -> tuple[float, list[float]]:
    """The speed chosen for the row, and all that were tried."""
    tried: list[float] = []

    def forecast(speed_m_s: float) -> RowForecast:
        tried.append(speed_m_s)
        return forecast_rows(row(**known), speed_m_s)

    limits = [SpeedLimit("a rule", limit_m_s) for limit_m_s in limits_m_s]
    return choose_speed(limits, forecast).ground_speed_m_s, tried


@pytest.mark.parametrize("limits_m_s", [(8.34, 12.0), (12.0, 8.34), (0.0567,)])
def test_no_speed_above_a_limit_is_tried(limits_m_s: tuple[float, ...]) -> None:
    speed_m_s, tried = chosen(*limits_m_s, local_s=0.0)
    highest_m_s = min(limits_m_s)
    assert max(tried) <= highest_m_s
    assert 0.8 * highest_m_s < speed_m_s <= highest_m_s


def test_where_answers_decide_the_lowest_speed_of_the_quickest_is_chosen() -> None:
    speed_m_s, _ = chosen(10.0)  # five answers of 10 s: 50 s at any speed whose second photo is there by 10 s
    slowest_m_s = 2.23  # 20 / v + v / 2 = 10.15 s: 0.2 % of the 76 s of the mission are allowed
    assert slowest_m_s <= speed_m_s <= slowest_m_s + 0.1


def test_the_reason_names_each_limit_and_the_speed_that_answers_allow() -> None:
    limits = [SpeedLimit("blur", 8.345), SpeedLimit("the camera", 20.0)]
    found = choose_speed(limits, lambda speed_m_s: forecast_rows(row(), speed_m_s))
    assert found.why.endswith("by forecast: blur allows 8.35, the camera 20, answers keep up to 2")
