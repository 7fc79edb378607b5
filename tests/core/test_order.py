"""Which order is taken, by how long the mission takes in each."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from upwash.core.geo import Circle, Position, Waypoint
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.operation import Operation
from upwash.core.planning.legs import Pace
from upwash.core.planning.mission_model import MissionBeliefs, StopCall
from upwash.core.planning.order import Forecaster, best_order, sweeps

GIVEN = [Waypoint(index, Position(20.0 * index, 0.0, 20.0)) for index in range(3)]
LOOK = Operation("detector", "process_photo", "heavy")
LEG_S, PHOTO_S, LOCAL_S, REMOTE_S, CHECK_S = 9.0, 1.0, 10.0, 0.5, 3.0  # 20 m at 4 m/s and 1 m/s²


def forecaster(*, stands: Position = GIVEN[0].position, **areas: Circle) -> Forecaster:
    there = Beliefs(check_s=CHECK_S, check_running_s=CHECK_S, remote_s={LOOK: REMOTE_S})
    return Forecaster(
        MissionBeliefs(GIVEN, 4.0, Pace(1.0), [StopCall(LOOK, PHOTO_S)]),
        Estimates(local_s={LOOK: LOCAL_S}, servers=dict.fromkeys(areas, there)),
        areas,
        gain_wait=0.25,
        stands=stands,
        home_s=lambda place: 16.0 + place.east_m,
    )


def test_the_forecast_has_the_way_out_and_home_every_leg_photo_and_call() -> None:
    calls_s = 3 * (PHOTO_S + LOCAL_S)
    assert forecaster().mission_s(GIVEN) == pytest.approx(2 * LEG_S + calls_s + 16 + 40)
    back = GIVEN[::-1]
    out_s = 40 / 4 + 4  # at 4 m/s and 1 m/s²
    assert forecaster().mission_s(back) == pytest.approx(out_s + 2 * LEG_S + calls_s + 16)


def test_the_forecast_has_calls_on_a_server_once_it_was_joined() -> None:
    last = forecaster(s1=Circle(Position(40.0, 0.0), 10.0))
    # Joined from half of the leg on, and through with it before the photo is taken.
    assert last.mission_s(GIVEN) == pytest.approx(2 * LEG_S + 3 * PHOTO_S + 2 * LOCAL_S + REMOTE_S + 16 + 40)


def taking(**times_s: float) -> tuple[str, list[int], int | None]:
    """What is taken where the given order takes 100 s and some sweeps less."""
    found = sweeps(GIVEN)
    by_order = {tuple(GIVEN): 100.0}
    for name, time_s in times_s.items():
        by_order[found[int(name.removeprefix("sweep_"))].waypoints] = time_s

    def mission_s(waypoints: Sequence[Waypoint]) -> float:
        return by_order.get(tuple(waypoints), 120.0)

    order = best_order(GIVEN, found, mission_s)
    return order.why, [each.index for each in order.waypoints], order.sweep


def test_a_sweep_is_taken_where_it_saves_two_per_cent_and_not_where_it_saves_less() -> None:
    why, indices, sweep = taking(sweep_1=98.0)
    assert (indices, sweep) == ([2, 1, 0], 1)
    assert why.startswith("sweep 1, by rows from the ")
    assert "saves 2.0 % by forecast (1.6 instead of 1.7 min)" in why
    why, indices, sweep = taking(sweep_1=98.1)
    assert (indices, sweep) == ([0, 1, 2], None)
    assert "less than 2 %" in why


def test_the_given_order_stays_where_no_sweep_is_quicker_or_allowed() -> None:
    assert taking() == ("as given: by forecast no sweep is quicker", [0, 1, 2], None)
    assert best_order(GIVEN, [], lambda _: 1.0).waypoints == tuple(GIVEN)
