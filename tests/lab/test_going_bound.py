"""The bound of a drone that may go on before answers are there: exact where it is known, and beaten by nobody."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.scenarios import scenario, server

from upwash.config import fleet_of, server_areas, waypoints
from upwash.core.bound import Onward
from upwash.core.geo import ground_distance_m
from upwash.lab.bounds import bound_of, bounds_of
from upwash.lab.run import simulate, simulate_drones

OTHER_S = 10.0 + 16.0 + 121.0 + 120 * 9.0  # taking off, coming home, photos, legs
ACTION_S = 5.0


def test_a_delay_is_hidden_by_the_way_where_the_answer_demands_nothing() -> None:
    onward = Onward(way_s=10.0, leg_s=9.0, demanded=False)
    assert [onward.least_wait_s(call_s, call_s) for call_s in (0.7, 10.0, 12.5)] == [0.0, 0.0, 2.5]
    assert onward.least_wait_s(30.0, 11.0) == 1.0, "a server on the way answers sooner"


def test_who_knows_what_is_demanded_stays_for_it() -> None:
    assert Onward(way_s=10.0, leg_s=9.0, demanded=True).least_wait_s(10.0, 10.0) == 10.0


def test_a_long_photo_is_worth_two_short_legs() -> None:
    # photo of 10 s, legs of 2 s: there, back and there again, all within the delay but for 4 s
    assert Onward(way_s=12.0, leg_s=2.0, demanded=True).least_wait_s(12.0, 12.0) == 4.0


@pytest.mark.parametrize("manner", ["go", "learn"])
def test_where_servers_answer_most_calls_it_is_what_geometry_says(manner: str) -> None:
    config = scenario(
        server("s1", 70.0, 110.0, range_m=100.0),
        server("s2", 130.0, 90.0, range_m=100.0),
        columns=11,
        rows=11,
        mission={"action_s": ACTION_S},
        policy={"stay_or_go": manner},
        event={"every": 10, "offset": 5},
    )
    areas = server_areas(config).values()
    delays_s = [
        0.7 if any(ground_distance_m(each.position, area.centre) < area.radius_m for area in areas) else 10.0
        for each in waypoints(config.mission)
    ]
    demanded_s = [delay_s + ACTION_S for index, delay_s in enumerate(delays_s) if index % 10 == 5]
    assert 100 < delays_s.count(0.7) < 121
    run = simulate(config)
    bound = bound_of(run, config)
    assert bound is not None
    assert bound.free_s == pytest.approx(OTHER_S + sum(demanded_s) + delays_s[-1], rel=1e-6)
    assert bound.with_joins_s == bound.free_s < run.result.mission_time_s


EVENTS = st.one_of(
    st.none(),
    st.fixed_dictionaries({"every": st.integers(1, 4), "offset": st.just(0)}),
    st.fixed_dictionaries({"probability": st.floats(0.0, 1.0)}),
)
SERVERS = st.lists(
    st.tuples(st.floats(-40.0, 80.0), st.floats(-40.0, 80.0), st.floats(5.0, 60.0)), max_size=2
)


@settings(max_examples=40, deadline=None)
@given(
    local_s=st.floats(0.1, 40.0),
    photo_s=st.floats(0.0, 15.0),
    spacing_m=st.floats(1.0, 50.0),
    event=EVENTS,
    servers=SERVERS,
    seed=st.integers(0, 10),
)
def test_nobody_is_faster(
    local_s: float,
    photo_s: float,
    spacing_m: float,
    event: dict[str, Any] | None,
    servers: list[tuple[float, float, float]],
    seed: int,
) -> None:
    times_s, bounds_s = [], []
    for manner in ("stay", "go", "learn"):
        config = scenario(
            *(server(f"s{number}", x, y, range_m=r) for number, (x, y, r) in enumerate(servers)),
            mission={"action_s": ACTION_S, "grid": {"columns": 3, "rows": 3, "spacing_m": spacing_m}},
            camera={"photo_s": photo_s},
            policy={"stay_or_go": manner},
            service=[{"name": "detector", "local_call_s": {"light": local_s, "heavy": local_s}}],
            seed=seed,
            **({"event": event} if event else {}),
        )
        run = simulate(config)
        bound = bound_of(run, config)
        assert bound is not None
        times_s.append(run.result.mission_time_s)
        bounds_s.append(bound.free_s if manner != "stay" else -math.inf)
    assert max(bounds_s) <= min(times_s) + 1e-6


def test_several_drones_that_go_share_servers_no_faster_than_they_can_compute() -> None:
    document: dict[str, Any] = {
        "drone": [{"name": "d1"}, {"name": "d2"}],
        "policy": {"stay_or_go": "go"},
        "event": {"every": 4},
    }
    config = scenario(server("s1", 50.0, 20.0, processing_s={"light": 0.2, "heavy": 0.6}), **document)
    runs = list(simulate_drones(config).values())
    own, together = bounds_of(runs, fleet_of(config))
    assert together is not None
    assert all(each is not None for each in own)
    mean_s = sum(run.result.mission_time_s for run in runs) / 2
    assert together.free_s <= together.shared_s <= mean_s
