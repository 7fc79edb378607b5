"""Surveys of ground stations, flown with their camera triggers."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import pytest
from tests.surveys import (
    END,
    HOME,
    PHOTO,
    SPOTS,
    TRANSECTS,
    Item,
    Place,
    at,
    begin,
    configured,
    gate,
    item,
    transects,
    written,
)

from upwash.config.drone_file import read_drone_config
from upwash.config.places import waypoints
from upwash.core.geo import distance_m
from upwash.drone.speed import photo_doubts
from upwash.errors import ConfigError
from upwash.eventlog import schema
from upwash.lab.simulation import Simulation, simulate


def of(run: Simulation, kind: type[schema.Event]) -> list[Any]:
    return [event for event in run.events if isinstance(event, kind)]


def assert_flown(run: Simulation, spots: list[Place], *, off_m: float = 0.1) -> None:
    """One photo at each place, in this order, in the foreseen time."""
    assert run.completed
    taken = [(photo.position.east_m, photo.position.north_m) for photo in of(run, schema.PhotoTaken)]
    assert len(taken) == len(spots)
    assert max(map(math.dist, taken, spots)) < off_m
    (foreseen,) = of(run, schema.Foreseen)
    assert run.mission_time_s == pytest.approx(foreseen.as_asked_s, rel=0.02)


def test_a_survey_is_photographed_on_its_transects_and_not_in_its_turns(tmp_path: Path) -> None:
    run = simulate(written(tmp_path, transects()))
    assert_flown(run, SPOTS)
    arrived = of(run, schema.Arrived)
    assert all(event.passing for event in arrived if event.waypoint is not None), "it enters a row at speed"


def test_a_survey_without_turns_stops_at_the_ends_of_its_transects(tmp_path: Path) -> None:
    run = simulate(written(tmp_path, transects(turn_m=0.0)))
    assert_flown(run, SPOTS)
    stops = [event.waypoint for event in of(run, schema.Arrived) if not event.passing]
    assert stops == [0, 5, 6, 11, 12, 17]


def test_a_survey_for_a_px4_has_gates_in_place_of_waypoints(tmp_path: Path) -> None:
    flown = transects()
    gated = [gate(*place) for row in TRANSECTS for place in row]
    for number, passed in zip((1, 3, 7, 9, 13, 15), gated, strict=True):
        flown[number] = passed
    assert_flown(simulate(written(tmp_path, flown)), SPOTS)


def test_photos_in_turns_are_taken_too(tmp_path: Path) -> None:
    """With this option of QGroundControl photos begin at each transect, and end at the last turn-around only."""
    first = [at(0, -10), begin(), at(0, 10), begin(), at(0, 100), at(0, 120)]
    items = [*first, at(20, 120), at(20, 100), begin(), at(20, 10), at(20, -10), END]
    run = simulate(written(tmp_path, items))
    north_m = [(0.0, float(at_m)) for at_m in range(-10, 111, 20)]
    south_m = [(20.0, float(at_m)) for at_m in (110, 100, 80, 60, 40, 20, 0, -10)]
    assert_flown(run, [*north_m, (10.0, 120.0), *south_m])


def test_a_corridor_is_photographed_around_its_bends(tmp_path: Path) -> None:
    """20 m apart along the way, where a bend is a place like others; a photo at the bend of 60 m."""
    items = [at(0, 10), begin(), at(50, 10), at(50, 20), at(50, 60), at(90, 60), END]
    run = simulate(written(tmp_path, items, kind="CorridorScan"))
    spots = [(0, 10), (20, 10), (40, 10), (50, 20), (50, 40), (50, 60), (70, 60), (90, 60)]
    assert_flown(run, [(float(east_m), float(north_m)) for east_m, north_m in spots])


def test_rings_around_a_structure_are_photographed_layer_by_layer(tmp_path: Path) -> None:
    """Two rings of 160 m, the second after a climb; the triggers end at each ring's end, with a photo."""
    corners: list[Place] = [(20, 20), (60, 20), (60, 60), (20, 60)]
    ring: list[Place] = [(20, 20), (50, 20), (60, 40), (50, 60), (20, 60), (20, 30), (20, 20)]
    items: list[Item] = []
    for altitude_m in (20.0, 30.0):
        first, *others = [at(*corner, altitude_m) for corner in [*corners, corners[0]]]
        items += [first, begin(30.0), *others, END]
    run = simulate(written(tmp_path, items))
    assert_flown(run, ring * 2)
    heights_m = [round(photo.position.altitude_m) for photo in of(run, schema.PhotoTaken)]
    assert heights_m == [20] * 7 + [30] * 7


def test_a_photo_at_each_waypoint_is_taken_at_rest_after_its_hold(tmp_path: Path) -> None:
    places: list[Place] = [(0, 20), (0, 50), (30, 50)]
    items = [part for place in places for part in (at(*place, hold_s=4.0), PHOTO)]
    run = simulate(written(tmp_path, items))
    assert_flown(run, places)
    photos, arrivals = of(run, schema.PhotoTaken), of(run, schema.Arrived)
    waited_s = [photo.t - photo.age_s - there.t for photo, there in zip(photos, arrivals, strict=True)]
    assert waited_s == pytest.approx([4.0] * 3)


def test_a_time_trigger_is_a_distance_at_the_speed_of_the_leg(tmp_path: Path) -> None:
    items = [at(0, 10), item(2000, 0, 5, 0), at(0, 70), item(178, 1, 8, -1), at(0, 130), item(2001)]
    run = simulate(written(tmp_path, items))
    north_m = (10, 30, 50, 70, 110)
    assert_flown(run, [(0.0, float(at_m)) for at_m in north_m])


def test_the_configurations_distance_counts_before_the_plans(tmp_path: Path) -> None:
    items = [at(0, 10), begin(1e9), at(0, 70), item(206, 0, 0, 0)]
    run = simulate(written(tmp_path, items, mission="photos = { every_m = 30.0 }"))
    assert_flown(run, [(0.0, 10.0), (0.0, 40.0), (0.0, 70.0)])


def test_a_grid_of_mission_planner_is_flown(tmp_path: Path) -> None:
    """Without a photo at the start (parameter 3 is 0), from a trigger before the first waypoint, never ended."""
    places = [(0, 10), (0, 70), (30, 70), (30, 10)]
    rows: list[list[object]] = [
        [0, 0, 16, 0, 0, 0, 0, *HOME, 100],
        [0, 3, 22, 0, 0, 0, 0, 0, 0, 20],
        [0, 3, 206, 25, 0, 0, 0, 0, 0, 0],
        *([0, 3, 16, 0, 0, 0, 0, *at(*place)["params"][4:6], 25] for place in places),
        [0, 3, 20, 0, 0, 0, 0, 0, 0, 0],
    ]
    lines = ["\t".join(map(str, [number, *row, 1])) for number, row in enumerate(rows)]
    (tmp_path / "field.plan").write_text("\n".join(["QGC WPL 110", *lines]))
    run = simulate(configured(tmp_path))
    assert_flown(run, [(0, 35), (0, 60), (15, 70), (30, 60), (30, 35), (30, 10)])


def test_a_photo_that_the_camera_cannot_keep_comes_sooner(tmp_path: Path) -> None:
    """The row ends 2 m after its last distance, and a photo takes 4 m of flight."""
    items = [at(0, 10), begin(40.0), at(0, 252), END]
    run = simulate(written(tmp_path, items, photo_s=1.0))
    assert_flown(run, [(0.0, float(at_m)) for at_m in (10, 50, 90, 130, 170, 210, 248, 252)])


def test_it_lands_where_the_plan_says_after_the_last_photo(tmp_path: Path) -> None:
    way = [at(0, 10), begin(), at(0, 50), END, at(40, 50), at(40, 0)]
    landing = item(21, 0, 0, 0, None, *at(40, 0)["params"][4:6], 0, frame=3)
    more = "[event]\nevery = 3\noffset = 2\n"  # of the last photo
    run = simulate(written(tmp_path, way, last=landing, more=more, heavy_s=8.0))
    assert run.completed and len(of(run, schema.Acted)) == 1
    (landed,) = of(run, schema.Landing)
    assert math.dist((landed.position.east_m, landed.position.north_m), (40, 0)) < 0.1
    reached = [(event.east_m, event.north_m) for event in of(run, schema.SetOff) if event.waypoint is None]
    assert [(round(east_m), round(north_m)) for east_m, north_m in reached[:1]] == [(40, 50)]


def test_demands_in_turns_are_met_and_each_spot_has_its_photo(tmp_path: Path) -> None:
    """Those of the last spots of rows are there in the turns."""
    more = "[event]\nevery = 3\noffset = 2\n"
    run = simulate(written(tmp_path, transects(), heavy_s=6.0, more=more))
    assert run.completed
    assert sorted(event.waypoint for event in of(run, schema.Acted)) == [2, 5, 8, 11, 14, 17]
    assert [event.waypoint for event in of(run, schema.CallStarted)] == list(range(18))
    taken = [(photo.position.east_m, photo.position.north_m) for photo in of(run, schema.PhotoTaken)]
    assert max(map(math.dist, taken, SPOTS)) < 0.5


@pytest.mark.parametrize(("at_most", "heavy_s"), [(100, 20.5), (100, 28.0), (10, 60.0)])
def test_a_demand_behind_a_fence_is_met_along_the_planned_way(
    tmp_path: Path, at_most: int, heavy_s: float
) -> None:
    """The photos of the first leg are answered on the legs after it, in flight or at a stop."""
    items = [at(0, 10), begin(), at(0, 110), at(60, 110), at(60, 10), END]
    fence: list[Place] = [(20, 0), (40, 0), (40, 90), (20, 90)]
    more = "[event]\nevery = 100\noffset = 1\n"
    mission = f"photos = {{ at_most = {at_most} }}"
    run = simulate(written(tmp_path, items, fence=fence, heavy_s=heavy_s, more=more, mission=mission))
    assert run.completed, run.failure
    (back,) = of(run, schema.TurnedBack)
    assert back.position.east_m > 40, "beyond the obstacle"
    (acted,) = of(run, schema.Acted)
    assert acted.waypoint == 1
    assert len(of(run, schema.PhotoTaken)) == 14


@pytest.mark.parametrize("seed", range(24))
def test_each_photo_of_a_drawn_plan_is_taken_at_its_place(tmp_path: Path, seed: int) -> None:
    """Legs at right angles with any triggers, holds, speeds and climbs; two of five answers have a demand."""
    drawn = random.Random(seed)
    commands = [begin(20.0), begin(13.0), item(206, 15, 0, 0), END, PHOTO, item(2000, 0, 4, 3), item(2001)]
    commands += [item(178, 1, speed_m_s, -1) for speed_m_s in (2, 8)]
    items, east_m, north_m = [at(0, 20), begin()], 0, 20
    for _ in range(drawn.randint(2, 7)):
        east_m, north_m = drawn.choice(
            [(east_m + 40, north_m), (east_m, north_m + 70), (east_m, north_m - 50)]
        )
        items.append(at(east_m, north_m, drawn.choice([25.0, 25.0, 35.0]), drawn.choice([0.0, 0.0, 3.0])))
        items += drawn.sample(commands, drawn.choice([0, 1, 2]))
    more = "[event]\nprobability = 0.4\n"
    file = written(tmp_path, [*items, at(0, 0)], photo_s=0.2, heavy_s=drawn.choice([1.0, 7.0]), more=more)
    spots, run = waypoints(read_drone_config(file).mission), simulate(file)
    assert run.completed, run.failure
    assert [event.waypoint for event in of(run, schema.CallStarted)] == [spot.index for spot in spots]
    taken = [photo.position for photo in of(run, schema.PhotoTaken)]
    assert all(distance_m(*pair) < 0.5 for pair in zip(taken, [spot.position for spot in spots], strict=True))
    acted = {event.waypoint for event in of(run, schema.Acted)}
    assert acted == {event.waypoint for event in of(run, schema.Demanded)}


def test_without_photos_a_drone_stops_at_each_waypoint_of_the_plan(tmp_path: Path) -> None:
    run = simulate(written(tmp_path, transects(), mission=""))
    assert run.completed and len(of(run, schema.PhotoTaken)) == 12
    assert not any(event.passing for event in of(run, schema.Arrived))


def test_a_turn_outside_the_geofence_is_refused(tmp_path: Path) -> None:
    fence: list[Place] = [(-5, 110), (45, 110), (45, 130), (-5, 130)]
    with pytest.raises(ConfigError, match="waypoint 3 is within exclusion polygon 1 of the geofence"):
        simulate(written(tmp_path, transects(), fence=fence))


TIMED = [0, 20, 40, 60, 80]  # metres from the first waypoint, at 4 m/s


@pytest.mark.parametrize(
    ("before", "between", "norths_m"),
    [
        ([item(214, 5000)], [], TIMED),
        ([item(214, 5000), item(214, 0)], [], TIMED),
        ([item(2000, 0, 5, 0), item(2000, 0, 0, 0)], [], TIMED),
        ([item(2000, 0, 5, -1)], [], TIMED),
        ([item(2000, 0, 5, 2)], [], [0, 20]),
        ([item(2000, 0, 0, 0)], [], [0]),
        ([item(260, 30)], [], [30, 60, 90]),
        ([item(206, 20)], [item(2001)], [20, 40, 60, 80]),
        ([item(206, 30)], [item(2000, 0, 5, 0)], [30, 60, 80]),
        ([item(2000, 0, 5, 0)], [item(206, 0)], TIMED),
        ([item(2000, 0, 5, 0), item(206, 10)], [item(2001)], [0, 20, 40, 60, 70, 80, 90]),
        ([item(206, 20)], [item(206, -1)], [20, 40, 60]),
        ([item(206, 20)], [item(2003, 0)], [20, 40, 60]),
        ([item(206, 20), item(2003, 0)], [item(2003, 1)], [80]),
        ([item(214, 5000), item(2003, 1, 0, 1)], [item(2003, 1)], [0, 60, 80]),
        ([item(206, 0, 0, 1)], [item(203), item(203, 0, 0, 0, 0, 1)], [0, 60]),
    ],
)
def test_commands_take_the_photos_that_autopilots_take(
    tmp_path: Path, before: list[Item], between: list[Item], norths_m: list[float]
) -> None:
    """Three waypoints in a row, 60 m and 35 m apart."""
    file = written(tmp_path, [at(0, 10), *before, at(0, 70), *between, at(0, 105)], photo_s=0.2)
    spots = waypoints(read_drone_config(file).mission)
    assert [spot.position.north_m - 10 for spot in spots] == pytest.approx(norths_m, abs=0.05)


ROW = [at(0, 10), begin(), at(0, 100), END]


@pytest.mark.parametrize(
    ("items", "changed", "refusal"),
    [
        ([at(0, 10), begin(0.001), at(0, 210)], {}, "more than 100,000 photos"),
        (
            [at(0, 10), begin(math.nan), at(0, 100)],
            {},
            r"item 3: MAV_CMD_DO_SET_CAM_TRIGG_DIST \(206\) names no distance: expected a distance above 0",
        ),
        (
            [at(0, 10), begin(-5.0), at(0, 100)],
            {},
            r"item 3: MAV_CMD_DO_SET_CAM_TRIGG_DIST \(206\) takes a photo each -5 m",
        ),
        ([at(0, 10), item(206, 1e9, 0, 0), at(0, 100)], {}, "no leg is as long as its trigger's distance"),
        (
            [at(0, 10), item(2000, 0, 0, 7), at(0, 100)],
            {},
            r"item 3: MAV_CMD_IMAGE_START_CAPTURE \(2000\) takes a photo each 0 s, and a photo takes camera.photo_s",
        ),
        (
            [at(0, 10), item(214, 2), at(0, 100)],
            {},
            r"item 3: MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL \(214\) takes a photo each 0.002 s, .*INTERVAL in mil",
        ),
        (
            [at(0, 10), item(260, 20, 0, 0, 3, 30), at(0, 100)],
            {},
            r"item 3: MAV_CMD_OBLIQUE_SURVEY \(260\) swings the camera .*TRIGG_DIST, 206",
        ),
        (
            [at(0, 10), item(2003, 1), at(0, 100)],
            {},
            r"item 3: MAV_CMD_DO_TRIGGER_CONTROL \(2003\) names no distance: .*or set photos.every_m",
        ),
        (
            [at(0, 10), item(203), item(2500), item(206, 0), at(0, 100)],
            {},
            r"triggers no camera \(item 3: .*\(203\): left out: it takes no photo, .* is 0, not 1; item 4: .*2500",
        ),
        ([at(0, 10), at(0, 100)], {}, "triggers no camera: plan a survey with a camera, or leave photos out"),
        (
            ROW,
            {"photo_s": 6.0},
            r"item 3: MAV_CMD_DO_SET_CAM_TRIGG_DIST \(206\) is too dense: a photo takes camera.photo_s = 6 s, so",
        ),
        (ROW, {"mission": "photos = {}\norder = 3"}, "rows are flown in the order of the file"),
    ],
)
def test_triggers_that_cannot_be_flown_are_refused(
    tmp_path: Path, items: list[Item], changed: dict[str, Any], refusal: str
) -> None:
    file = written(tmp_path, items, **changed)
    with pytest.raises(ConfigError, match=refusal):
        read_drone_config(file)
    read_drone_config(written(tmp_path, items, mission=""))


def test_blur_and_gaps_are_those_of_the_plans_legs(tmp_path: Path) -> None:
    """At 25 m a photo shows 22.5 m along the flight and a pixel 7.5 mm; the take-off is at 20 m."""
    items = [
        at(0, 10),
        begin(22.0),
        at(0, 100),
        item(178, 1, 8, -1),
        at(0, 200),
        END,
        at(0, 200, 5.0),
        at(0, 0, 5.0),
    ]
    file = written(tmp_path, items)
    lens = "[camera]\nfov_deg = 62.0\nphoto_px = [4000, 3000]\nexposure_s = "
    text = file.read_text()
    file.write_text(text.replace("[camera]\n", f"{lens}0.0009\n"))
    assert list(photo_doubts(read_drone_config(file))) == []
    file.write_text(text.replace("[camera]\n", f"{lens}0.001\n").replace("{}", "{ every_m = 23.0 }"))
    doubts = dict(photo_doubts(read_drone_config(file)))
    assert doubts["blur"].startswith("the ground moves by 1.1 pixels")
    assert "a photo shows 22.5 m of a row, so that one every 23 m leaves gaps" in doubts["gaps"]


def test_a_grid_needs_a_distance(tmp_path: Path) -> None:
    mission = "photos = {}\ngrid = { columns = 3, rows = 2, spacing_m = 20.0 }"
    file = configured(tmp_path, mission=mission)
    file.write_text(file.read_text().replace('plan = "field.plan"\n', ""))
    with pytest.raises(ConfigError, match=r"mission\.photos\.every_m: missing"):
        read_drone_config(file)
