"""A plan's altitudes above the sea, on a vehicle whose home lies somewhere above it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.config.places import waypoints
from upwash.core.geo import Position
from upwash.drone.home import above_home, planned_home
from upwash.errors import AutopilotRefused
from upwash.ports import VehicleLimits

SEA, HOME = 0, 3  # MAV_FRAME
HERE = Position(0.0, 0.0)


def item(command: int, frame: int, north_deg: float, altitude_m: float) -> dict[str, Any]:
    parameters = [0, 0, 0, None, 39.3666 + north_deg, 22.9507, altitude_m]
    return {
        "type": "SimpleItem",
        "command": command,
        "frame": frame,
        "params": parameters,
        "autoContinue": True,
    }


def planned(
    folder: Path, *altitudes: tuple[int, float], home_m: float = 0, takeoff: Any = None
) -> DroneConfig:
    """A mission over waypoints of those frames and altitudes, and a planned home of that altitude above the sea."""
    legs = [
        item(16, frame, 0.0001 * (number + 1), metres) for number, (frame, metres) in enumerate(altitudes)
    ]
    document = {
        "fileType": "Plan",
        "version": 1,
        "mission": {
            "version": 2,
            "firmwareType": 3,
            "vehicleType": 2,
            "plannedHomePosition": [39.3666, 22.9507, home_m],
            "items": [item(22, *(takeoff or (HOME, 0, 15))), *legs],
        },
    }
    (folder / "field.plan").write_text(json.dumps(document))
    return drone_config({"mission": {"plan": "field.plan"}}, folder / "drone.toml")


def altitudes(config: DroneConfig) -> list[float]:
    return [waypoint.position.altitude_m for waypoint in waypoints(config.mission)]


def test_they_count_from_the_vehicles_home_where_the_planned_one_is_unknown(tmp_path: Path) -> None:
    config = planned(tmp_path, (SEA, 530.0), (HOME, 20.0), (SEA, 533.5))
    flown = above_home(config, 488.0)
    assert altitudes(flown) == [42.0, 20.0, 45.5]
    assert flown.mission.altitude_m == 15.0


def test_they_count_from_the_vehicles_home_where_the_planned_one_agrees_with_it(tmp_path: Path) -> None:
    config = planned(tmp_path, (SEA, 530.0), home_m=480.0)
    assert altitudes(config) == [50.0]
    assert altitudes(above_home(config, 488.0)) == [42.0]
    assert altitudes(above_home(config, 510.0)) == [20.0]


def test_a_place_one_metre_above_home_is_flown(tmp_path: Path) -> None:
    assert altitudes(above_home(planned(tmp_path, (SEA, 489.0)), 488.0)) == [1.0]


def test_a_take_off_above_the_sea_counts_from_there_too(tmp_path: Path) -> None:
    config = planned(tmp_path, (SEA, 530.0), takeoff=(SEA, 0, 508))
    assert above_home(config, 488.0).mission.altitude_m == 20.0


@pytest.mark.parametrize("home_m", [0.0, 100.0, 488.0])
def test_altitudes_above_home_are_left_as_they_are(tmp_path: Path, home_m: float) -> None:
    config = planned(tmp_path, (HOME, 20.0), home_m=home_m)
    assert above_home(config, 488.0) is config


def test_homes_that_do_not_agree_are_refused_with_both_and_the_file(tmp_path: Path) -> None:
    config = planned(tmp_path, (HOME, 20.0), (SEA, 130.0), home_m=100.0)
    with pytest.raises(AutopilotRefused) as caught:
        above_home(config, 488.0)
    said = caught.value.problem
    for part in (
        str(tmp_path / "field.plan"),
        "item 3",
        "100 m above the sea",
        "488 m",
        "30 m",
        "nothing was sent",
    ):
        assert part in said


@pytest.mark.parametrize(
    ("above_sea_m", "takeoff", "what"),
    [
        (
            488.5,
            None,
            "item 2 is 488.5 m above the sea and the vehicle's home 488 m: that is 0.5 m above home",
        ),
        (
            470.0,
            None,
            "item 2 is 470 m above the sea and the vehicle's home 488 m: that is -18.0 m above home",
        ),
        (530.0, (SEA, 0, 480), "the take-off is 480 m above the sea and the vehicle's home 488 m"),
    ],
)
def test_places_that_are_not_above_the_vehicles_home_are_refused(
    tmp_path: Path, above_sea_m: float, takeoff: Any, what: str
) -> None:
    config = planned(tmp_path, (SEA, above_sea_m), takeoff=takeoff)
    with pytest.raises(AutopilotRefused) as caught:
        above_home(config, 488.0)
    assert what in caught.value.problem


def test_a_home_that_rose_since_they_were_converted_is_told_and_then_refused(tmp_path: Path) -> None:
    home = planned_home(above_home(planned(tmp_path, (SEA, 530.0)), 488.0).mission)
    assert list(home.doubts(VehicleLimits(home_above_sea_m=489.0), HERE)) == []
    assert list(home.doubts(VehicleLimits(home_above_sea_m=491.0), HERE)) == []
    (doubt,) = home.doubts(VehicleLimits(home_above_sea_m=491.5), HERE)
    assert "converted with a home at 488 m above the sea, and the vehicle's home 491.5 m" in doubt
    home.require_same(VehicleLimits(home_above_sea_m=518.0))
    with pytest.raises(
        AutopilotRefused, match="with a home at 488 m, and the vehicle's home is now at 519 m"
    ):
        home.require_same(VehicleLimits(home_above_sea_m=519.0))


def test_a_plan_above_home_that_was_made_for_another_place_is_told(tmp_path: Path) -> None:
    home = planned_home(planned(tmp_path, (HOME, 20.0), home_m=100.0).mission)
    far = VehicleLimits(home_above_sea_m=488.0)
    home.require_same(far)
    assert list(home.doubts(far, HERE)) == [
        "the plan's home is 100 m above the sea, and the vehicle's home 488 m: check that the plan is of this place"
    ]
    assert list(home.doubts(VehicleLimits(home_above_sea_m=120.0), HERE)) == []
    assert list(home.doubts(VehicleLimits(), Position(60.0, 80.0))) == []
    assert list(home.doubts(VehicleLimits(), Position(90.0, 120.0))) == [
        "the vehicle stands 150 m from the plan's home, and returns to its own home"
    ]


def test_without_a_plan_there_is_no_planned_home(tmp_path: Path) -> None:
    config = drone_config({"mission": {"waypoints_m": [[0, 0]]}}, tmp_path / "drone.toml")
    assert (
        list(planned_home(config.mission).doubts(VehicleLimits(home_above_sea_m=488.0), Position(900.0, 0)))
        == []
    )
