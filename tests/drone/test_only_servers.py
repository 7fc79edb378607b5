"""Calls of services that only servers run: what a mission gets, and when, on virtual time."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from msgspec.structs import replace
from tests.drone.test_pending import of

from upwash import Drone, Unanswered, once, service
from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.core.geo import Circle, Position, ground_distance_m
from upwash.core.planning.answer_stops import AnswerStops
from upwash.drone.resumption import waypoints_done
from upwash.errors import DeclarationError, UsageError
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate_fleet
from upwash.launch.survey import services_in_trouble
from upwash.missions.bundled import load_specs
from upwash.services import Detector


@service(where="servers")
class Segmenter:
    def segment(self, photo: bytes) -> list[int]:
        return [len(photo)]


@service(where="servers", name="segmenter")
class Raising:
    def segment(self, photo: bytes) -> list[int]:
        raise ValueError("no ground in it")


@service(name="segmenter")
class Anywhere:
    def segment(self, photo: bytes) -> list[int]:
        return []


EVERY = list(range(10))
ROWS = {"mission": {"waypoints_m": [[0.0, 0.0], [180.0, 0.0]], "photos": {"every_m": 20.0}}}
FAR = (1000.0, 0.0)


def scenario(
    *, server_m: tuple[float, float] = (100.0, 0.0), call_s: float = 1.0, **tables: Any
) -> DroneConfig:
    """Ten waypoints, 20 m apart; the server s1 reaches 30 m far, is ready 2 s after that, and answers in `call_s`."""
    document: dict[str, Any] = {
        "mission": {
            "altitude_m": 20.0,
            "ground_speed_m_s": 4.0,
            "waypoints_m": [[20.0 * index, 0.0] for index in EVERY],
            **tables.pop("mission", {}),
        },
        "vehicle": {"acceleration_m_s2": 1.0, "takeoff_s": 10.0, "return_and_land_s": 30.0},
        "policy": {"name": "location-aware", **tables.pop("policy", {})},
        "camera": {"photo_s": 1.0},
        "service": [
            {"name": "segmenter", "program": f"{__name__}:Segmenter", **tables.pop("segmenter", {})},
            {"name": "detector", "local_call_s": {"light": 3.0, "heavy": 10.0}},
        ],
        "server": [
            {
                "name": "s1",
                "east_m": server_m[0],
                "north_m": server_m[1],
                "range_m": 30.0,
                "check_s": 2.0,
                "check_running_s": 2.0,
                "remote_call_s": {"segmenter": call_s, "detector": {"light": 0.5, "heavy": 1.0}},
            }
        ],
        **tables,
    }
    return drone_config(document, Path("scenario.toml"))


def flown(config: DroneConfig, mission: Callable[[Drone], None], *, computing: bool = True) -> Run:
    with patch("upwash.lab.run.load_mission", lambda *_, **__: mission):
        (run,) = simulate_fleet([config], computing=computing)
    return run


def survey(
    *, heard: list[Any] | None = None, demanding: int | None = None, **chosen: Any
) -> Callable[[Drone], None]:
    """Starts a call at each waypoint; notes the answers, and acts on the one of the `demanding` waypoint."""

    def program(drone: Drone) -> None:
        segmenter = drone.service(Segmenter, **{"unanswered": None, **chosen})
        drone.autopilot.arm()
        drone.autopilot.takeoff(drone.altitude_m)
        for waypoint in drone.plan:
            drone.autopilot.goto(waypoint)

            def look(found: object, index: int = waypoint.index) -> bool:
                if heard is not None:
                    heard.append((index, found))
                return index == demanding

            pending = drone.start(segmenter.segment, drone.camera.take_photo())
            drone.stay_or_go(pending, lambda _: drone.autopilot.hover(1.0), demands=look, failed=look)
        drone.end_flight()
        drone.autopilot.disarm()

    return program


def answered(run: Run) -> list[int]:
    return [call.waypoint for call in of(list(run.events), schema.Call)]


def unanswered(run: Run) -> list[int]:
    return [ended.waypoint for ended in of(list(run.events), schema.Unanswered)]


def home_s(run: Run) -> float:
    (returning,) = of(list(run.events), schema.Returning)
    return float(returning.t)


@pytest.mark.parametrize("policy", ["location-aware", "look-ahead", "opportunistic"])
@pytest.mark.parametrize("tables", [{}, ROWS], ids=["stops", "rows"])
def test_calls_wait_for_the_next_range_and_the_last_ones_for_a_stop_beside_the_way_home(
    policy: str, tables: dict[str, Any]
) -> None:
    heard: list[Any] = []
    run = flown(scenario(policy={"name": policy}, **tables), survey(heard=heard))
    assert not run.failure
    assert answered(run) == EVERY
    assert {call.place for call in of(list(run.events), schema.Call)} == {"s1"}
    assert [found for _, found in sorted(heard)] == [[3]] * 10
    assert {ready.service for ready in of(list(run.events), schema.LocalReady)} == {"detector"}
    (sought,) = of(list(run.events), schema.SoughtAnswers)
    assert ground_distance_m(sought.position, Position(100.0, 0.0)) < 30.0


@pytest.mark.parametrize(
    ("tables", "why"),
    [
        ({"server_m": FAR}, "the flight is over, and no server in range answers"),
        ({"policy": {"name": "local-only"}}, "the flight is over, and no server in range answers"),
        ({"server_m": FAR, **ROWS}, "the flight is over, and no server in range answers"),
        ({"fault": [{"target": "s1", "kind": "off"}]}, "the flight is over, and no server in range answers"),
        (
            {"server_m": FAR, "segmenter": {"waiting_bytes": 6}},
            "calls that wait for a server keep more than service.waiting_bytes = 6",
        ),
    ],
    ids=["far", "local-only", "rows", "off", "memory"],
)
def test_the_flight_ends_though_no_server_ever_answers(tables: dict[str, Any], why: str) -> None:
    heard: list[Any] = []
    run = flown(scenario(**tables), survey(heard=heard))
    assert not run.failure
    assert run.result.completed
    assert sorted(heard) == [(index, None) for index in EVERY]
    assert sorted(unanswered(run)) == EVERY
    assert why in run.result.unanswered
    assert run.result.mission_time_s < 400


def test_the_oldest_calls_end_at_the_bound_of_memory() -> None:
    run = flown(scenario(server_m=FAR, segmenter={"waiting_bytes": 100}), survey())
    early = [ended for ended in of(list(run.events), schema.Unanswered) if ended.t <= home_s(run)]
    assert [ended.waypoint for ended in early] == [0, 1]  # a request of three bytes has twelve


def test_a_call_ends_once_at_its_deadline() -> None:
    run = flown(scenario(), survey(within_s=20.0))
    assert sorted([*answered(run), *unanswered(run)]) == EVERY
    assert {0, 1} <= set(unanswered(run))
    ended = of(list(run.events), schema.Unanswered)
    assert {round(event.waited_s, 6) for event in ended} == {20.0}
    assert {event.within_s for event in ended} == {20.0}
    assert run.result.unanswered == {"no server answered within 20 s": sorted(unanswered(run))}


def test_the_exception_that_a_mission_chose_is_its_to_handle() -> None:
    heard: list[Any] = []
    run = flown(scenario(server_m=FAR), survey(heard=heard, unanswered=Unanswered, within_s=5.0))
    assert run.result.completed
    assert [(index, type(error)) for index, error in heard] == [(index, Unanswered) for index in EVERY]
    assert not of(list(run.events), schema.TurnedBack)


def waiting(segmenter_calls: list[Any], **chosen: Any) -> Callable[[Drone], None]:
    """Waits for a call at each waypoint."""

    def program(drone: Drone) -> None:
        segmenter = drone.service(Segmenter, **{"unanswered": None, **chosen})
        drone.autopilot.arm()
        drone.autopilot.takeoff(drone.altitude_m)
        for waypoint in drone.plan:
            drone.autopilot.goto(waypoint)
            segmenter_calls.append(segmenter.segment(drone.camera.take_photo()))
        drone.end_flight()
        drone.autopilot.disarm()

    return program


def test_a_mission_that_waits_without_a_deadline_waits_only_in_range() -> None:
    found: list[Any] = []
    run = flown(scenario(), waiting(found))
    assert found == [None, None, None, None, [3], [3], [3], None, None, None]
    assert all(event.waited_s == 0 for event in of(list(run.events), schema.Unanswered))


def test_a_mission_that_waits_waits_no_longer_than_its_deadline() -> None:
    found: list[Any] = []
    run = flown(scenario(), waiting(found, within_s=4.0))
    assert found == [None, None, None, None, [3], [3], [3], None, None, None]
    assert {event.waited_s for event in of(list(run.events), schema.Unanswered)} == {4.0}


def test_a_pending_call_that_is_dropped_or_waited_for_does_not_hold_up_the_flight() -> None:
    def program(drone: Drone) -> None:
        segmenter = drone.service(Segmenter, unanswered=None)
        detector = drone.service(Detector)
        drone.autopilot.arm()
        drone.autopilot.takeoff(drone.altitude_m)
        photo = drone.camera.take_photo()
        assert drone.start(segmenter.segment, photo).result() is None
        drone.start(segmenter.segment, photo).cancel()
        detector.process_photo(photo, "light")
        drone.end_flight()
        drone.autopilot.disarm()

    run = flown(scenario(server_m=FAR), program, computing=False)
    assert run.result.completed, run.failure
    assert list(run.result.unanswered) == [
        "no server in range can answer, and the mission waits",
        "the mission dropped it",
    ]


def test_calls_of_other_services_are_not_held_up() -> None:
    def both(drone: Drone, *, with_segmenter: bool) -> None:
        segmenter, detector = drone.service(Segmenter, unanswered=None), drone.service(Detector)
        drone.autopilot.arm()
        drone.autopilot.takeoff(drone.altitude_m)
        for waypoint in drone.plan:
            drone.autopilot.goto(waypoint)
            photo = drone.camera.take_photo()
            if with_segmenter:
                drone.stay_or_go(drone.start(segmenter.segment, photo), lambda _: None)
            detector.process_photo(photo, "light")
        drone.end_flight()
        drone.autopilot.disarm()

    config = scenario(server_m=FAR)
    alone = flown(config, partial(both, with_segmenter=False), computing=False)
    beside = flown(config, partial(both, with_segmenter=True), computing=False)
    assert beside.result.mission_time_s == pytest.approx(alone.result.mission_time_s)


@pytest.mark.parametrize("tables", [{}, ROWS], ids=["stops", "rows"])
def test_a_late_demand_turns_the_drone_back_to_its_place(tables: dict[str, Any]) -> None:
    run = flown(scenario(**tables), survey(demanding=1))
    (back,) = of(list(run.events), schema.TurnedBack)
    assert back.waypoint == 1
    acted_s = next(event.t for event in of(list(run.events), schema.Acted))
    place = next(event for event in reversed(of(list(run.events), schema.Arrived)) if event.t < acted_s)
    assert (place.waypoint, place.east_m) == (1, 20.0)
    assert answered(run) == EVERY


def test_a_call_that_a_server_fails_is_in_line_again() -> None:
    first_s = of(list(flown(scenario(), survey()).events), schema.Call)[0].t
    fault = {"target": "s1", "kind": "off", "from_s": first_s - 0.5, "to_s": first_s + 5.0}
    run = flown(scenario(fault=[fault]), survey())
    assert of(list(run.events), schema.RemoteFailed)
    assert sorted(answered(run)) == EVERY


def test_an_exception_that_servers_report_twice_ends_the_call() -> None:
    config = scenario(segmenter={"program": f"{__name__}:Raising"})
    heard: list[Any] = []
    run = flown(config, survey(heard=heard))
    assert not run.failure
    assert [found for _, found in heard] == [None] * 10
    assert any(
        "raised builtins.ValueError: no ground in it, as at the attempt" in why
        for why in run.result.unanswered
    )


@pytest.mark.parametrize(
    ("server_m", "policy", "stops", "late"),
    [
        ((100.0, 0.0), {}, 1, EVERY),
        ((100.0, 0.0), {"detour_s": 0.0}, 0, EVERY),
        ((0.0, 10.0), {}, 0, EVERY),
        ((150.0, 60.0), {}, 1, EVERY),
        ((150.0, 60.0), {"detour_s": 5.0}, 0, []),
    ],
    ids=["on the way home", "no stop allowed", "at home", "beside the way", "too far beside"],
)
def test_where_the_drone_stops_for_what_waits(
    server_m: tuple[float, float], policy: dict[str, Any], stops: int, late: list[int]
) -> None:
    run = flown(scenario(server_m=server_m, policy=policy), survey())
    assert len(of(list(run.events), schema.SoughtAnswers)) == stops
    assert sorted(answered(run)) == late
    assert not of(list(run.events), schema.Demanded)


@pytest.mark.parametrize(("endurance_s", "all_answered"), [(600.0, True), (180.0, False)])
def test_a_stop_ends_before_the_reserve_would_end_the_flight(endurance_s: float, all_answered: bool) -> None:
    config = scenario(server_m=(150.0, 60.0), mission={"reserve_s": 20.0})
    run = flown(replace(config, vehicle=replace(config.vehicle, endurance_s=endurance_s)), survey())
    assert run.result.completed, run.failure
    assert sorted([*answered(run), *unanswered(run)]) == EVERY
    assert (len(answered(run)) == 10) == all_answered


def test_the_drone_waits_before_it_leaves_the_last_range_of_its_way() -> None:
    places = [[200.0, 80.0], [30.0, 60.0], [30.0, 80.0], [30.0, 140.0], [0.0, 280.0]]
    mission = {"waypoints_m": places}
    run = flown(
        scenario(server_m=(30.0, 80.0), call_s=12.0, mission=mission, policy={"stay_or_go": "go"}), survey()
    )
    sought, *_ = of(list(run.events), schema.SoughtAnswers)
    assert ground_distance_m(sought.position, Position(30.0, 80.0)) < 0.01
    left_s = next(event.t for event in of(list(run.events), schema.SetOff) if event.waypoint == 3)
    assert [call.waypoint for call in of(list(run.events), schema.Call) if call.t <= left_s] == [0, 1, 2]


@pytest.mark.parametrize("tables", [{}, ROWS], ids=["stops", "rows"])
def test_after_a_kill_a_photo_counts_as_done_after_its_answer_or_without_one(tables: dict[str, Any]) -> None:
    config = scenario(**tables)
    run = flown(config, survey(within_s=60.0))
    events = list(run.events)
    moments = [number for number, event in enumerate(events) if isinstance(event, schema.AnswerTaken)]
    assert len(moments) == 10
    for number in moments:
        taken = {event.waypoint for event in events[:number] if isinstance(event, schema.AnswerTaken)}
        assert waypoints_done(events[:number], config) == taken


# --- what is refused -----------------------------------------------------------------------------------------


def test_a_method_that_runs_once_contradicts_a_service_of_servers() -> None:
    with pytest.raises(DeclarationError, match="release runs once, and on the drone alone"):

        @service(where="servers")
        class Gripper:
            @once
            def release(self) -> None: ...


def test_a_service_of_servers_cannot_be_part_of_one_that_runs_on_the_drone() -> None:
    with pytest.raises(DeclarationError, match='declare it with @service\\(where="servers"\\) too'):

        @service
        class Inspection:
            def __init__(self, segmenter: Segmenter) -> None: ...

            def inspect(self, photo: bytes) -> None: ...


@pytest.mark.parametrize(
    ("asks", "remedy"),
    [
        (lambda drone: drone.service(Segmenter), "say what a call without an answer returns"),
        (lambda drone: drone.service(Segmenter, unanswered=None, within_s=0.0), "give seconds above 0"),
        (lambda drone: drone.service(Segmenter, unanswered=None, within_s=math.inf), "give seconds above 0"),
        (lambda drone: drone.service(Detector, unanswered=[]), "leave unanswered and within_s out"),
        (lambda drone: drone.service(Detector, within_s=3.0), "leave unanswered and within_s out"),
    ],
)
def test_a_mission_says_before_take_off_what_a_call_without_an_answer_returns(
    asks: Callable[[Drone], object], remedy: str
) -> None:
    def program(drone: Drone) -> None:
        asks(drone)
        drone.autopilot.arm()

    run = flown(scenario(), program)
    assert remedy in run.failure
    assert not of(list(run.events), schema.Arming)


@pytest.mark.parametrize(
    ("segmenter", "problem"),
    [
        ({"local_call_s": 3.0}, 'it has a local_call_s, and is declared with where="servers"'),
        ({"program": f"{__name__}:Anywhere"}, "local_call_s is missing"),
    ],
)
def test_a_file_that_contradicts_the_declaration_is_refused(segmenter: dict[str, Any], problem: str) -> None:
    with pytest.raises(UsageError) as refusal:
        flown(scenario(segmenter=segmenter), survey())
    assert problem in str(refusal.value)


@service(where="servers", name="segmenter")
class Tuned:
    def __init__(self, *, words: str) -> None:
        raise AssertionError("no instance of it is made")

    def segment(self, photo: bytes) -> list[int]:
        return []


async def test_the_drone_needs_no_settings_and_starts_no_instance_of_it() -> None:
    config = scenario(segmenter={"program": f"{__name__}:Tuned"})
    config = replace(config, services=config.services[:1])
    assert load_specs(config.services)["segmenter"].where == "servers"
    assert await services_in_trouble(config, {"photo": b"\xff\xd8"}) == []


# --- where ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("end", "place", "passes"),
    [
        (Position(100.0, 0.0), Position(41.0, 0.0), True),  # the first place well inside, on the way
        (Position(50.0, 0.0), Position(41.0, 0.0), True),
        (Position(20.0, 0.0), Position(41.0, 0.0), False),  # beside its end
        (Position(50.0, 50.0), Position(50.0, 9.0), False),
    ],
)
def test_the_place_to_stop_is_the_first_in_a_range_or_else_the_one_least_beside_the_way(
    end: Position, place: Position, passes: bool
) -> None:
    stops = AnswerStops([Circle(Position(50.0, 0.0), 10.0)])
    found = stops.beside(Position(0.0, 0.0), end)
    assert found is not None
    if end.north_m == 0:
        assert (found.east_m, found.north_m) == pytest.approx((place.east_m, place.north_m))
    assert stops.contains(found)
    assert stops.passed([Position(0.0, 0.0), end]) == passes
