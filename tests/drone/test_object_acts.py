"""One object, one act: what the drone does at the places of objects, and the second look."""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.drone.test_pending import in_the_air
from tests.drone.test_pending import of as of_list
from tests.drone.test_resume import Part, at_once, fly, scenario
from tests.drone.test_rows import ROWS
from tests.drone.test_stay_or_go import going
from tests.surveys import END, Item, at, begin, written

from upwash import Drone, FoundObject
from upwash.config.drone import DroneConfig
from upwash.config.drone_file import read_drone_config
from upwash.config.world import ObjectConfig
from upwash.core.geo import Position, ground_distance_m
from upwash.drone.resumption import waypoints_done
from upwash.errors import ConfigError
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.run import Run, simulate
from upwash.ports import Camera
from upwash.report.findings import Finder
from upwash.services import Detector
from upwash.sim.camera import ObjectCamera

# --- a survey that QGroundControl has planned: six transects with turn-arounds, and nine objects -------------

STONES = [(east_m, north_m) for east_m in (7.0, 21.0, 33.0) for north_m in (25.0, 50.0, 75.0)]
ALTITUDE_M, LOW_M = 25.0, 8.0


def transects() -> list[Item]:
    items = []
    for number in range(6):
        east_m, (start_m, end_m) = 8.0 * number, (10.0, 90.0) if number % 2 == 0 else (90.0, 10.0)
        turn_m = math.copysign(12.0, end_m - start_m)
        items += [at(east_m, start_m - turn_m), at(east_m, start_m), begin(8.0), at(east_m, end_m), END]
        items.append(at(east_m, end_m + turn_m))
    return items


def survey(
    tmp_path: Path,
    mission: str = "",
    *,
    stones: Sequence[tuple[float, float]] = STONES,
    fence: list[tuple[float, float]] | None = None,
) -> Run:
    drawn = ", ".join(f'{{ label = "stone", east_m = {east}, north_m = {north} }}' for east, north in stones)
    file = written(
        tmp_path,
        transects(),
        mission=f"photos = {{}}\n{mission}",
        photo_s=0.3,
        heavy_s=2.0,
        more=f"[event]\nobjects = [{drawn}]" if stones else "",
        speed_m_s=5.0,
        fence=fence,
    )
    text = file.read_text(encoding="utf-8").replace("action_s = 5.0\n", "", 1)
    file.write_text(text.replace("[camera]\n", "[camera]\nfov_deg = 42.0\n"), encoding="utf-8")
    run = simulate(read_drone_config(file))
    assert run.failure == "" and run.result.completed
    return run


def nearest(place: Position, spots: Sequence[tuple[float, float]] = STONES) -> tuple[int, float]:
    """The number of the spot that is nearest to the place, and how far it is from there."""
    return min(
        ((number, ground_distance_m(place, Position(*spot))) for number, spot in enumerate(spots)),
        key=lambda found: found[1],
    )


def of(events: Sequence[Event], kind: type[schema.Event]) -> list[Any]:
    return of_list(list(events), kind)


def acted(events: Sequence[Event]) -> list[schema.FoundRecord]:
    return [event.object for event in of(events, schema.Acted) if event.object is not None]


def sightings(events: Sequence[Event]) -> Counter[int]:
    finder = Finder()
    found = [finding for event in events for finding in finder.take(event)]
    return Counter(nearest(finding.place)[0] for finding in found)


def test_a_survey_that_tells_takes_as_long_as_one_that_finds_nothing(tmp_path: Path) -> None:
    quiet, tells = survey(tmp_path, stones=()), survey(tmp_path)
    seen = sightings(tells.events)
    assert len(seen) == len(STONES) and 3.5 <= seen.total() / len(STONES) <= 4.5
    assert tells.result.mission_time_s == pytest.approx(quiet.result.mission_time_s, rel=0.03)
    assert not of(tells.events, schema.TurnedBack)


def test_a_survey_that_acts_visits_each_object_once_where_it_lies(tmp_path: Path) -> None:
    run = survey(tmp_path, "action_s = 5.0")
    places = [record.place for record in acted(run.events)]
    assert Counter(nearest(place)[0] for place in places if place) == Counter(range(len(STONES)))
    assert all(nearest(place)[1] < 3.0 for place in places if place)
    flown_to = [event for event in of(run.events, schema.Arrived) if event.waypoint is None]
    assert {nearest(Position(event.east_m, event.north_m))[0] for event in flown_to} == set(range(9))
    assert not run.result.not_acted_on


def test_each_object_gets_a_second_look_from_lower_down(tmp_path: Path) -> None:
    run = survey(tmp_path, f"second_look = {{ altitude_m = {LOW_M} }}")
    looks = [event for event in of(run.events, schema.PhotoTaken) if event.object is not None]
    assert Counter(nearest(look.position)[0] for look in looks) == Counter(range(len(STONES)))
    assert all(look.position.altitude_m == pytest.approx(LOW_M, abs=0.1) for look in looks)
    assert sorted(event.object for event in looks) == sorted(record.number for record in acted(run.events))
    assert len(of(run.events, schema.PhotoTaken)) - len(looks) == len(
        of(survey(tmp_path).events, schema.PhotoTaken)
    )
    told = [event for event in of(run.events, schema.Notified) if event.at.altitude_m < ALTITUDE_M]
    assert Counter(nearest(event.at)[0] for event in told) == Counter(range(len(STONES)))


def test_only_objects_with_these_labels_and_scores_are_looked_at_again(tmp_path: Path) -> None:
    assert not acted(survey(tmp_path, 'second_look = { altitude_m = 8.0, labels = ["deer"] }').events)
    unsure = acted(survey(tmp_path, "second_look = { altitude_m = 8.0, below_score = 0.7 }").events)
    assert 0 < len(unsure) < len(STONES)


def test_an_object_behind_a_fence_is_left_out_and_the_survey_goes_on(tmp_path: Path) -> None:
    around = [(45.0, 40.0), (45.0, 60.0), (56.0, 60.0), (56.0, 40.0)]
    run = survey(tmp_path, "action_s = 5.0", stones=[(47.0, 50.0), (7.0, 50.0)], fence=around)
    (left_out,) = of(run.events, schema.NotActed)
    assert "fence" in left_out.why
    assert [nearest(record.place)[0] for record in acted(run.events) if record.place] == [1]
    assert not run.result.not_acted_on


# --- a few waypoints ------------------------------------------------------------------------------------------


def camera(*spots: tuple[float, float]) -> Callable[..., Camera]:
    """A camera over stones at these places."""

    def made(*, photo_s: float, events: object, in_flight: bool) -> Camera:
        config = scenario(**PLACES).camera
        config = msgspec.structs.replace(config, photo_s=photo_s)
        stones = [ObjectConfig(label="stone", east_m=east_m, north_m=north_m) for east_m, north_m in spots]
        return ObjectCamera(stones, config, in_flight=in_flight, chance=random.Random(1))

    return made


PLACES = {"waypoints_m": [[0, 0], [8, 0], [16, 0], [24, 0], [60, 0]]}
SPOT = (12.0, 5.0)


def acts(config: DroneConfig, *spots: tuple[float, float], **more: Any) -> Part:
    part = fly(config, camera=camera(*spots), **more)
    assert part.error is None, part.error
    return part


def acting(**more: Any) -> DroneConfig:
    return scenario(**(PLACES | {"action_s": 5.0} | more))


def rows(**more: Any) -> DroneConfig:
    return acting(waypoints_m=ROWS, photos={"every_m": 8.0}, **more)


@pytest.mark.parametrize("manner", ["stay", "go", "learn"])
def test_at_stops_an_object_on_several_photos_has_one_act_at_its_place(manner: str) -> None:
    part = acts(going(acting(), manner), SPOT)
    (record,) = acted(part.events)
    assert record.place is not None and nearest(record.place, [SPOT])[1] < 3.0
    (turned,) = of(part.events, schema.TurnedBack)
    assert turned.object == record.number


def test_an_urgent_act_begins_with_its_answer() -> None:
    part = acts(at_once(rows()), (100.0, 5.0))
    (demanded,), (turned,) = of(part.events, schema.Demanded), of(part.events, schema.TurnedBack)
    assert turned.t - demanded.t < 4.0 and not of(part.events, schema.PutOff)


def test_an_answer_in_flight_at_stops_brakes_for_an_urgent_act() -> None:
    part = acts(going(at_once(acting())), SPOT)
    demanded, turned = of(part.events, schema.Demanded)[0], of(part.events, schema.TurnedBack)[0]
    assert turned.t - demanded.t < 4.0


@pytest.mark.parametrize("mission", [{}, {"waypoints_m": [[0, 0], [60, 0]], "photos": {"every_m": 8.0}}])
def test_a_flight_that_was_killed_acts_on_each_object_once(mission: dict[str, Any]) -> None:
    config = acting(second_look={"altitude_m": 8.0}, **mission)
    spots = SPOT, (30.0, -4.0), (50.0, 2.0)
    whole = acts(config, *spots)
    assert visits(whole, spots) == Counter(range(3))
    moments = [
        event.t + 0.01 for event in whole.events if isinstance(event, (schema.PhotoTaken, schema.Acted))
    ]
    for killed_at_s in moments[::3]:
        first = fly(config, camera=camera(*spots), killed_at_s=killed_at_s)
        both = acts(config, *spots, after=first)
        assert visits(both, spots) == Counter(range(3)), killed_at_s
        assert both.result.completed and not both.result.not_acted_on


def visits(part: Part, spots: Sequence[tuple[float, float]]) -> Counter[int]:
    """How often each of the spots was acted on."""
    return Counter(nearest(record.place, spots)[0] for record in acted(part.events) if record.place)


def test_an_object_whose_act_is_due_leaves_its_waypoint_undone() -> None:
    part = acts(rows(), (20.0, 3.0))
    demanded = of(part.events, schema.Demanded)[0]
    until = [event for event in part.events if event.t <= demanded.t + 0.1]
    assert demanded.waypoint not in waypoints_done(until, rows())
    assert demanded.waypoint in waypoints_done(part.events[:-1], rows())


def test_findings_without_a_place_have_one_act_where_their_photo_was_taken() -> None:
    config = scenario(second_look={"altitude_m": 8.0})
    part = fly(config, shows=[Position(20.0, 0.0)])
    assert part.error is None
    looks = [event for event in of(part.events, schema.PhotoTaken) if event.object is not None]
    assert [look.position.east_m for look in looks] == pytest.approx([20.0], abs=0.1)
    assert [look.position.altitude_m for look in looks] == pytest.approx([8.0], abs=0.1)


def test_a_mission_of_ones_own_says_which_objects_it_acts_on() -> None:
    heard: list[FoundObject] = []

    def program(drone: Drone, detector: Detector) -> None:
        for waypoint in drone.plan:
            drone.autopilot.goto(waypoint)
            pending = drone.start(detector.process_photo, drone.camera.take_photo(), mode="light")
            drone.act_once(pending, heard.append, wanted=lambda found: found.position.east_m > 30)

    acts(acting(), SPOT, (60.0, 5.0), mission=in_the_air(program))
    (found,) = heard
    assert found.label == "stone" and found.place is not None
    assert found.position.altitude_m == pytest.approx(20.0)
    assert found.over(7.0).altitude_m == pytest.approx(7.0)


def test_a_second_look_from_no_lower_down_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"mission\.second_look\.altitude_m: 20 m, and photos are taken"):
        scenario(second_look={"altitude_m": 20.0})
