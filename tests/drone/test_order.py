"""Waypoints that are flown in another order than they were given in."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.events import event
from tests.scenarios import scenario, server

from upwash import simulate
from upwash.config.drone import DroneConfig
from upwash.config.drone_file import fleet_of, read_drone_config
from upwash.core.planning.order import Order
from upwash.drone.preparation import order_of
from upwash.drone.resumption import order_begun
from upwash.errors import ConfigError, UsageError
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate_drones
from upwash.lab.run import simulate as fly
from upwash.missions.bundled import load_specs

RASTER = {"columns": 4, "rows": 3, "spacing_m": 20.0, "rows_alternate": False, "start": "bottom-left"}
BACK_AND_FORTH = [0, 1, 2, 3, 7, 6, 5, 4, 8, 9, 10, 11]
HOME = {"latitude_deg": 39.3666, "longitude_deg": 22.9507}


def order(config: DroneConfig) -> Order:
    return order_of(config, load_specs(config.services))


def indices(order: Order) -> list[int]:
    return [waypoint.index for waypoint in order.waypoints]


def reached(run: Run) -> list[int | None]:
    return [event.waypoint for event in run.events if isinstance(event, schema.Arrived)]


def planned(run: Run) -> schema.Planned:
    return next(event for event in run.events if isinstance(event, schema.Planned))


def test_without_a_word_of_it_the_order_is_the_given_one_and_the_log_says_nothing() -> None:
    run = fly(scenario())
    assert reached(run) == list(range(18))
    assert (planned(run).order, planned(run).order_why) == ([], "")
    assert planned(run).way_m == planned(run).waypoints_m


def test_the_best_sweep_is_flown_and_logged_and_every_waypoint_keeps_its_index() -> None:
    given = fly(scenario(mission={"grid": RASTER}))
    best = fly(scenario(mission={"grid": RASTER, "order": "best-sweep"}))
    assert reached(best) == [call.waypoint for call in best.result.calls] == BACK_AND_FORTH
    assert best.result.mission_time_s < 0.98 * given.result.mission_time_s
    assert planned(best).waypoints_m == planned(given).waypoints_m
    assert planned(best).order == BACK_AND_FORTH
    assert planned(best).order_why.startswith("sweep 0, by rows from the bottom-left: saves ")
    assert planned(best).way_m[4] == (60.0, 20.0)


@pytest.mark.parametrize("number", range(8))
def test_every_sweep_can_be_asked_for_by_its_number(number: int) -> None:
    run = fly(scenario(server("s1", 100.0, 40.0), mission={"order": number}))
    assert run.result.completed
    assert sorted(index for index in reached(run) if index is not None) == list(range(18))
    assert planned(run).order_why.startswith(f"sweep {number}, by ")


def test_a_drone_that_never_offloads_is_not_sent_past_servers() -> None:
    config = scenario(server("s1", 0.0, 0.0), mission={"order": "best-sweep"}, policy={"name": "local-only"})
    alone = scenario(mission={"order": "best-sweep"})
    assert order(config) == order(alone)


def test_the_way_home_counts_by_its_length_where_a_profile_says_how_it_is_flown() -> None:
    """Nine rows end far from where the vehicle stands, two columns near it."""
    columns = {"grid": {"columns": 2, "rows": 9, "spacing_m": 60.0, "start": "bottom-left"}}
    mission = {**columns, "mode": "light", "order": "best-sweep"}
    assert order(scenario(mission=mission)).sweep is None
    assert order(scenario(mission=mission, vehicle={"profile": "px4"})).sweep == 4


# --- what the file may ask for ------------------------------------------------------------------------------


def test_waypoints_that_form_no_grid_are_refused() -> None:
    crooked = {"grid": None, "waypoints_m": [[0, 0], [20, 5], [90, 0]]}
    assert scenario(mission={**crooked, "order": "by-index"}), "which is the given order, of one drone"
    for asked in ("best-sweep", 3):
        with pytest.raises(
            ConfigError, match=r"mission\.order: the waypoints of drone form no full grid .* leave it out"
        ):
            scenario(mission={**crooked, "order": asked})


@pytest.mark.parametrize("asked", [8, -1, "best", True])
def test_an_unknown_order_is_refused(asked: object) -> None:
    with pytest.raises(
        ConfigError, match=r'mission\.order.*"best-sweep", "by-index", or a number of a sweep'
    ):
        scenario(mission={"order": asked})


def test_orders_can_be_compared_by_the_keys_of_campaigns() -> None:
    document = {
        "mission": {"grid": RASTER},
        "service": [{"name": "detector", "local_call_s": {"light": 3.0, "heavy": 10.0}}],
    }
    times_s = [
        simulate(document, overrides={"mission.order": each}).mission_time_s
        for each in ("given", "best-sweep", 0)
    ]
    assert times_s[0] > times_s[1] == times_s[2]


# --- plans --------------------------------------------------------------------------------------------------


def degrees(east_m: float, north_m: float) -> tuple[float, float]:
    return HOME["latitude_deg"] + north_m / 111_030.0, HOME["longitude_deg"] + east_m / 86_200.0


def plan_file(folder: Path, order: object, *, keep_out: tuple[float, float] | None = None) -> Path:
    """A plan over two columns and three rows, the last of which is flown at 2 m/s, and a drone that flies it."""
    places = [(0, 40), (40, 40), (40, 80), (0, 80), (0, 120), (40, 120)]
    items: list[dict[str, Any]] = []
    for number, (east_m, north_m) in enumerate(places):
        if number == 4:
            items.append(item(len(items) + 1, 178, [1, 2.0, -1, 0, 0, 0, 0], frame=2))
        latitude, longitude = degrees(east_m, north_m)
        items.append(item(len(items) + 1, 16, [0, 0, 0, None, latitude, longitude, 20.0]))
    circles = []
    if keep_out is not None:
        centre = degrees(*keep_out)
        circles = [{"version": 1, "inclusion": False, "circle": {"center": list(centre), "radius": 10.0}}]
    plan = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {"version": 2, "circles": circles, "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
        "mission": {
            "version": 2,
            "firmwareType": 3,
            "vehicleType": 2,
            "cruiseSpeed": 15,
            "hoverSpeed": 4,
            "plannedHomePosition": [HOME["latitude_deg"], HOME["longitude_deg"], 100],
            "items": items,
        },
    }
    (folder / "field.plan").write_text(json.dumps(plan))
    file = folder / "drone.toml"
    file.write_text(
        f'[mission]\nplan = "field.plan"\norder = {json.dumps(order)}\n'
        '[[service]]\nname = "detector"\nlocal_call_s = { light = 3.0, heavy = 10.0 }\n'
    )
    return file


def item(number: int, command: int, params: list[float | None], *, frame: int = 3) -> dict[str, Any]:
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": command,
        "doJumpId": number,
        "frame": frame,
        "params": params,
    }


def test_a_plan_can_be_swept_and_each_waypoint_keeps_its_speed(tmp_path: Path) -> None:
    found = order(read_drone_config(plan_file(tmp_path, 1)))
    assert indices(found) == [5, 4, 3, 2, 1, 0]
    speeds = {waypoint.index: waypoint.ground_speed_m_s for waypoint in found.waypoints}
    assert speeds == {0: 4.0, 1: 4.0, 2: 4.0, 3: 4.0, 4: 2.0, 5: 2.0}


def test_a_sweep_that_does_not_keep_to_the_geofence_is_refused_and_never_the_best(tmp_path: Path) -> None:
    way = (20.0, 80.0)  # between two waypoints of the middle row, which only sweeps by rows fly
    by_columns = plan_file(tmp_path, 4, keep_out=(20.0, 60.0))
    assert indices(order(read_drone_config(by_columns))) == [0, 3, 4, 5, 2, 1]
    with pytest.raises(ConfigError, match=r"the straight way from waypoint 2 to waypoint 3 crosses"):
        read_drone_config(plan_file(tmp_path, "best-sweep", keep_out=way))
    home_corner = (30.0, 25.0)  # on the way from home to the waypoint east of the first
    with pytest.raises(
        ConfigError,
        match=r"mission\.order: sweep \d, by \w+ from the bottom-right, does not keep drone to exclusion",
    ):
        read_drone_config(plan_file(tmp_path, 3, keep_out=home_corner))
    best = order(read_drone_config(plan_file(tmp_path, "best-sweep", keep_out=home_corner)))
    assert "the geofence forbids 2 of 8 sweeps" in best.why
    assert best.waypoints[0].index != 1


# --- several drones -----------------------------------------------------------------------------------------


def test_by_index_each_drone_flies_the_sweep_of_its_number() -> None:
    config = scenario(
        mission={"order": "by-index"},
        columns=3,
        rows=3,
        drone=[
            {"name": f"d{number}", **({"waypoints_m": [[0, 0], [20, 0]]} if number == 9 else {})}
            for number in range(10)
        ],
    )
    assert [each.mission.order for each in fleet_of(config)] == [*range(8), 0, 1]
    runs = simulate_drones(config)
    ways = [tuple(reached(run)) for run in runs.values()]
    assert len(set(ways[:8])) == 8
    assert ways[0] == ways[8] == tuple(range(9))
    assert ways[9] == (1, 0)


def test_a_drone_whose_waypoints_form_no_grid_is_named() -> None:
    with pytest.raises(ConfigError, match=r"mission\.order: the waypoints of d2 form no full grid"):
        scenario(
            mission={"order": "by-index"},
            drone=[{"name": "d1"}, {"name": "d2", "waypoints_m": [[0, 0], [20, 5], [90, 0]]}],
        )


# --- a flight that is taken up ------------------------------------------------------------------------------

OPENED = event("log_opened", 0.0, time="2026-01-01T00:00:00+00:00")


def test_a_flight_that_is_taken_up_keeps_to_its_order_whatever_would_be_decided_now() -> None:
    run = fly(scenario(mission={"grid": RASTER, "order": "best-sweep"}))
    now = scenario(mission={"grid": RASTER})
    found = order_begun([OPENED, *run.events], now)
    assert found is not None
    assert indices(found) == BACK_AND_FORTH
    assert found.why == planned(run).order_why


def test_the_given_order_is_kept_to_too_and_of_an_earlier_flight_nothing() -> None:
    now = scenario(mission={"grid": RASTER, "order": "best-sweep"})
    given = planned(fly(scenario(mission={"grid": RASTER})))
    found = order_begun([OPENED, given], now)
    assert found is not None
    assert indices(found) == list(range(12))
    assert order_begun([OPENED, given, OPENED], now) is None


def test_an_order_of_other_waypoints_is_refused() -> None:
    begun = msgspec.structs.replace(planned(fly(scenario())), order=[0, 2, 1])
    with pytest.raises(UsageError, match="of another plan"):
        order_begun([begun], scenario())
