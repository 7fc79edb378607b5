"""The bound of a drone that may go on before answers are there: exact where it is known, and beaten by nobody."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.scenarios import scenario, server

from upwash.config.drone_file import drone_config, fleet_of
from upwash.config.places import server_areas, waypoints
from upwash.lab.bounds import bound_of, bounds_of
from upwash.lab.run import simulate, simulate_drones

ACTION_S, PHOTO_S = 5.0, 1.0


@pytest.mark.parametrize("manner", ["go", "learn"])
def test_where_servers_answer_most_calls_it_is_what_a_model_of_the_question_says(manner: str) -> None:
    # 26 s up and down, 121 photos, 120 legs of 9 s, which hide all delays but that of the last call, and 12 actions
    config = scenario(
        server("s1", 80.0, 80.0, range_m=105.0),
        server("s2", 120.0, 120.0, range_m=105.0),
        columns=11,
        rows=11,
        mission={"action_s": ACTION_S},
        policy={"stay_or_go": manner},
        event={"every": 10, "offset": 5},
    )
    areas = server_areas(config).values()
    covered = [
        waypoint
        for waypoint in waypoints(config.mission)
        if any(area.contains(waypoint.position) for area in areas)
    ]
    assert len(covered) == 107
    run = simulate(config)
    bound = bound_of(run, config)
    assert bound is not None
    assert bound.free_s == pytest.approx(26.0 + 121 * PHOTO_S + 120 * 9.0 + 12 * ACTION_S)
    assert bound.with_joins_s == bound.free_s < run.result.mission_time_s


EVENTS = st.one_of(
    st.none(),
    st.fixed_dictionaries({"every": st.integers(1, 4), "offset": st.just(0)}),
    st.fixed_dictionaries({"probability": st.floats(0.0, 1.0)}),
)
SERVERS = st.lists(
    st.tuples(st.floats(-40.0, 80.0), st.floats(-40.0, 80.0), st.floats(5.0, 60.0)), max_size=2
)


@st.composite
def worlds(draw: st.DrawFn) -> dict[str, Any]:
    """A small survey, without noise; what is left out is how the drone goes."""
    local_s, spacing_m = draw(st.floats(0.1, 40.0)), draw(st.floats(1.0, 50.0))
    servers = [
        server(f"s{number}", east_m, north_m, range_m=range_m)
        for number, (east_m, north_m, range_m) in enumerate(draw(SERVERS))
    ]
    event = draw(EVENTS)
    return {
        "mission": {
            "mode": "heavy",
            "action_s": ACTION_S,
            "grid": {"columns": 3, "rows": 3, "spacing_m": spacing_m},
        },
        "camera": {"photo_s": draw(st.floats(0.0, 15.0))},
        "service": [{"name": "detector", "local_call_s": {"light": local_s, "heavy": local_s}}],
        "server": servers,
        "seed": draw(st.integers(0, 10)),
        **({"event": event} if event else {}),
    }


@settings(max_examples=40, deadline=None)
@given(worlds())
def test_nobody_is_faster(world: dict[str, Any]) -> None:
    times_s, bounds_s = [], []
    for manner in ("stay", "go", "learn"):
        config = drone_config({**world, "policy": {"stay_or_go": manner}}, Path("scenario.toml"))
        run = simulate(config)
        bound = bound_of(run, config)
        assert bound is not None
        times_s.append(run.result.mission_time_s)
        bounds_s.append(bound.free_s if manner != "stay" else -math.inf)
    assert max(bounds_s) <= min(times_s) + 1e-4  # a log rounds its times


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
