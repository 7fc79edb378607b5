"""How flights end that cannot go on: every cause, every action, on virtual time."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
from rich.console import Console

from upwash.config import DroneConfig, FaultConfig, SafeEnd, waypoints
from upwash.config.drone_file import drone_config
from upwash.core.geo import Position
from upwash.drone import Drone, Flight, World
from upwash.errors import (
    AutopilotOverruled,
    AutopilotRefused,
    InstanceError,
    MissionFailed,
    MissionStopped,
    Unreachable,
)
from upwash.missions.survey import survey
from upwash.ports import Program
from upwash.results import RunResult, read_result
from upwash.service import spec_of
from upwash.services import Detector
from upwash.sim.autopilot import ModelAutopilot, Plain
from upwash.sim.camera import ModelCamera
from upwash.sim.chance import Chance
from upwash.sim.faults import Faults
from upwash.sim.journal import MemoryJournal
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.loop import run_virtually
from upwash.sim.network import NoNetwork
from upwash.sim.runtime import ModelRuntime
from upwash.sim.world import DroneComputer
from upwash.terminal import Progress, print_result

ACTIONS: tuple[SafeEnd, ...] = ("return", "land", "hold")
SPECS = {"detector": spec_of(Detector)}
# Take-off is over at 10 s, waypoints are 100 m and 29 s apart, and photo and call of each take 11 s: from 21 to 50 s
# the drone is on the way to waypoint 1.
SCENARIO: dict[str, Any] = {
    "mission": {"waypoints_m": [[0, 0], [100, 0], [200, 0], [300, 0]]},
    "service": [{"name": "detector", "local_call_s": {"light": 3.0, "heavy": 10.0}}],
}


def scenario(**tables: dict[str, Any]) -> DroneConfig:
    document = {name: {**SCENARIO.get(name, {}), **table} for name, table in tables.items()}
    return drone_config({**SCENARIO, **document}, Path("scenario.toml"))


class Wire:
    """To the drone's own services; once cut, nothing goes over it."""

    def __init__(self) -> None:
        self.cut = False

    def connected(self, server: str) -> bool:
        return True

    async def send(self, server: str, path: str, *, reply: bool) -> None:
        if self.cut:
            raise Unreachable("the service has crashed")


@dataclass
class Scene:
    """A flight with everything around it."""

    flight: Flight
    autopilot: ModelAutopilot
    journal: MemoryJournal
    wire: Wire

    def events(self, name: str) -> list[dict[str, Any]]:
        return [event for event in self.journal.events if event["event"] == name]

    @property
    def result(self) -> RunResult:
        return read_result(self.journal.events)


def fly(
    config: DroneConfig,
    mission: Callable[[Drone], None] = survey,
    *,
    at_s: float = 40.0,
    happens: Callable[[Scene], object] = lambda _: None,
    autopilot: type[ModelAutopilot] = ModelAutopilot,
) -> tuple[Scene, BaseException | None]:
    """Flies until the mission has ended; returns how it looks then, and what ended it."""

    async def run() -> tuple[Scene, BaseException | None]:
        scene = make_scene(config, mission, autopilot)
        asyncio.get_running_loop().call_later(at_s, happens, scene)
        try:
            await scene.flight.run()
        except Exception as error:  # noqa: BLE001 - the test looks at it
            return scene, error
        return scene, None

    return run_virtually(run())


def make_scene(config: DroneConfig, mission: Callable[[Drone], None], kind: type[ModelAutopilot]) -> Scene:
    journal, wire, onboard = MemoryJournal(), Wire(), Switchboard({})
    journal.begin()
    faults, vehicle = Faults(config.faults), config.vehicle
    autopilot = kind(
        waypoints(config.mission)[0].position,
        ground_speed_m_s=config.mission.ground_speed_m_s,
        manner=Plain(
            acceleration_m_s2=vehicle.acceleration_m_s2,
            takeoff_s=vehicle.takeoff_s,
            return_and_land_s=vehicle.return_and_land_s,
        ),
        fault=lambda: faults.now("autopilot"),
        endurance_s=vehicle.endurance_s,
    )
    computer = DroneComputer(config.services, heat=None, noise=0.0, chance=Chance(1))
    dialer = ModelDialer(config.name, onboard, wire)
    world = World(
        autopilot=autopilot,
        networks=[NoNetwork()],
        dialer=dialer,
        onboard_dialer=dialer,
        onboard_runtime=ModelRuntime(SPECS, computer, onboard),
        camera=ModelCamera(photo_s=config.camera.photo_s),
        notifier=journal,
        journal=journal,
    )
    programs = {"detector": Program("upwash.services:Detector")}
    flight = Flight(mission, config, services={"detector": Detector}, programs=programs, world=world)
    return Scene(flight, autopilot, journal, wire)


def assert_ended_in(action: SafeEnd, scene: Scene) -> None:
    (safe_end,) = scene.events("safe_end")
    assert safe_end["action"] == action
    place = scene.autopilot.position
    assert (place.altitude_m > 0) == (action == "hold")
    assert (place.east_m == 0) == (action == "return")
    ended = "left_hovering" if action == "hold" else "landed"
    assert [event["event"] for event in scene.journal.events[-2:]] == [ended, "mission_ended"]
    assert scene.result.left_hovering == (action == "hold")
    assert not scene.result.completed


def interrupt(scene: Scene) -> None:
    scene.flight.stop("Ctrl-C")


def cut_the_wire(scene: Scene) -> None:
    scene.wire.cut = True


def fail_at_waypoint_1(drone: Drone) -> None:
    drone.autopilot.arm()
    drone.autopilot.takeoff(10)
    drone.autopilot.goto(drone.plan[1])
    raise ValueError("the mission has a bug")


@pytest.mark.parametrize("action", ACTIONS)
def test_a_mission_that_raises(action: SafeEnd) -> None:
    scene, error = fly(scenario(autopilot={"on_failure": action}), fail_at_waypoint_1)
    assert isinstance(error, MissionFailed)
    assert_ended_in(action, scene)


@pytest.mark.parametrize("action", ACTIONS)
def test_ctrl_c(action: SafeEnd) -> None:
    scene, error = fly(scenario(autopilot={"on_failure": action}), happens=interrupt)
    assert isinstance(error, MissionStopped)
    assert_ended_in(action, scene)
    assert scene.events("safe_end")[0]["t"] == 40.0
    assert scene.result.undone == [1, 2, 3]


@pytest.mark.parametrize("action", ACTIONS)
def test_a_lost_service(action: SafeEnd) -> None:
    scene, error = fly(scenario(autopilot={"on_failure": action}), happens=cut_the_wire)
    assert isinstance(error, InstanceError)
    assert_ended_in(action, scene)
    assert scene.result.undone == [2, 3]


@pytest.mark.parametrize("action", ACTIONS)
def test_a_lost_autopilot_link_is_tried_again_until_it_is_back(action: SafeEnd) -> None:
    config = scenario(autopilot={"on_failure": action})
    lost = FaultConfig(target="autopilot", kind="off", from_s=50.0, to_s=200.0)
    scene, error = fly(msgspec.structs.replace(config, faults=(lost,)))
    assert "link is silent" in str(error)
    assert len(scene.events("safe_end_failed")) == 1, "told once, though tried many times"
    assert_ended_in(action, scene)
    ended = scene.events("landed") or scene.events("left_hovering")
    assert 200.0 <= ended[0]["t"] <= 200.0 + 2.0 + 16.0


def test_a_link_that_stays_lost_is_given_up_in_the_end() -> None:
    lost = FaultConfig(target="autopilot", kind="off", from_s=50.0)
    scene, error = fly(msgspec.structs.replace(scenario(), faults=(lost,)))
    assert "link is silent" in str(error)
    (left,) = scene.events("left_to_pilot")
    assert left["t"] - scene.events("safe_end")[0]["t"] == pytest.approx(600.0, abs=3.0)


@pytest.mark.parametrize("action", ACTIONS)
def test_a_battery_below_the_reserve(action: SafeEnd) -> None:
    config = scenario(
        mission={"reserve_percent": 25.0},
        vehicle={"endurance_s": 80.0},
        autopilot={"on_failure": action},
    )
    scene, error = fly(config)
    assert isinstance(error, MissionStopped) and "reserve of 25 %" in str(error)
    assert_ended_in(action, scene)
    assert scene.events("stopping")[0]["t"] == pytest.approx(0.75 * 80.0, abs=1.0)
    assert (scene.result.waypoints, scene.result.undone) == (4, [2, 3])


def test_a_battery_that_lasts_ends_nothing() -> None:
    scene, error = fly(scenario(mission={"reserve_percent": 25.0}, vehicle={"endurance_s": 1000.0}))
    assert error is None
    assert scene.result.undone == []


def test_a_mission_on_its_way_down_is_not_ended_by_the_battery() -> None:
    well, _ = fly(scenario())
    returning_s = well.events("returning")[0]["t"]
    config = scenario(
        mission={"reserve_percent": 50.0},
        vehicle={"endurance_s": 2 * (returning_s + 3.0)},
        autopilot={"on_failure": "hold"},
    )
    scene, error = fly(config)
    assert error is None
    assert scene.autopilot.position.altitude_m == 0.0


def test_a_battery_below_the_reserve_from_the_start_keeps_the_drone_on_the_ground() -> None:
    class Empty(ModelAutopilot):
        battery_percent = 10.0

    scene, error = fly(scenario(mission={"reserve_percent": 25.0}), autopilot=Empty)
    assert isinstance(error, MissionStopped)
    assert not scene.events("took_off") and not scene.events("safe_end")


def test_a_battery_that_nobody_reports_is_said_to_be_unwatched() -> None:
    scene, error = fly(scenario(mission={"reserve_percent": 25.0}))
    assert error is None
    assert len(scene.events("battery_watch_failed")) == 1


@pytest.mark.parametrize("action", ACTIONS)
def test_a_mission_that_ends_in_the_air_without_saying_how(action: SafeEnd) -> None:
    def forget_to_land(drone: Drone) -> None:
        drone.autopilot.arm()
        drone.autopilot.takeoff(10)
        drone.autopilot.goto(drone.plan[1])

    scene, error = fly(scenario(autopilot={"on_failure": action}), forget_to_land)
    assert error is None
    assert scene.events("safe_end")[0]["action"] == action
    assert (scene.autopilot.position.altitude_m > 0) == (action == "hold")


def test_a_mission_that_swallows_the_stop_was_still_stopped() -> None:
    def stubborn(drone: Drone) -> None:
        try:
            survey(drone)
        except MissionStopped:
            return

    scene, error = fly(scenario(), stubborn, happens=interrupt)
    assert isinstance(error, MissionStopped)
    assert_ended_in("return", scene)


def test_a_vehicle_that_the_pilot_has_taken_is_left_to_the_pilot() -> None:
    class Taken(ModelAutopilot):
        async def goto(self, position: Position) -> None:
            if position.east_m == 200.0:
                raise AutopilotOverruled("goto", "the pilot has taken over")
            await super().goto(position)

    scene, error = fly(scenario(), autopilot=Taken)
    assert isinstance(error, AutopilotOverruled)
    assert not scene.events("safe_end")
    assert [event["event"] for event in scene.journal.events[-2:]] == ["left_to_pilot", "mission_ended"]
    assert scene.autopilot.position.altitude_m == 20.0


def test_a_pilot_who_takes_over_during_the_safe_end_is_left_alone() -> None:
    class Taken(ModelAutopilot):
        async def return_home_and_land(self) -> None:
            raise AutopilotOverruled("return", "the pilot has taken over")

    scene, _ = fly(scenario(), happens=interrupt, autopilot=Taken)
    assert [event["event"] for event in scene.journal.events[-2:]] == ["left_to_pilot", "mission_ended"]


def test_a_vehicle_that_refuses_at_first_is_asked_again() -> None:
    class Reluctant(ModelAutopilot):
        refusals = 0

        async def land(self) -> None:
            if self.refusals < 3:
                self.refusals += 1
                raise AutopilotRefused("land", "not now")
            await super().land()

    scene, _ = fly(scenario(autopilot={"on_failure": "land"}), happens=interrupt, autopilot=Reluctant)
    assert_ended_in("land", scene)


@pytest.mark.parametrize("action", ACTIONS)
def test_a_person_is_told_in_words(action: SafeEnd) -> None:
    config = scenario(autopilot={"on_failure": action})
    scene, _ = fly(config, happens=interrupt)
    console = Console(width=300, file=io.StringIO())
    progress = Progress(config, 4, console)
    for event in scene.journal.events:
        progress.follow(event)
    print_result(scene.result, console, paced=False)
    told = console.file.getvalue()  # type: ignore[attr-defined]
    assert {"return": "returning to land", "land": "landing where it is", "hold": "stopping"}[action] in told
    assert "1 of 4 waypoints reached, left undone: 1-3" in told
    assert (told.count("hovers where it is, and nobody flies it") == 2) == (action == "hold")
