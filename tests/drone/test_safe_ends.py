"""How flights end that cannot go on: every cause, every action, on virtual time."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import pytest
from rich.console import Console
from tests.events import event, written

from upwash.config.drone import AutopilotConfig, DroneConfig, SafeEnd
from upwash.config.drone_file import drone_config
from upwash.config.flight_times import pace_in_numbers
from upwash.config.places import waypoints
from upwash.config.world import FaultConfig
from upwash.core.vehicle.control import Control, Owner
from upwash.drone.api import Drone
from upwash.drone.flight import Flight, Ports
from upwash.drone.networks import NoNetwork
from upwash.errors import (
    AutopilotOverruled,
    AutopilotRefused,
    InstanceError,
    MissionFailed,
    MissionStopped,
    ReserveReached,
    Unreachable,
)
from upwash.eventlog.results import RunResult, read_result
from upwash.eventlog.schema import VehicleSaid
from upwash.eventlog.terminal import FlightProgress, print_result
from upwash.missions.survey import survey
from upwash.ports import DeadManAction, Program, VehicleNews
from upwash.rpc.service import spec_of
from upwash.services import Detector
from upwash.sim.autopilot import ModelAutopilot, ModelDeadMan
from upwash.sim.camera import ModelCamera
from upwash.sim.chance import Chance
from upwash.sim.faults import Faults
from upwash.sim.journal import MemoryJournal
from upwash.sim.link import ModelDialer, Switchboard, Wire
from upwash.sim.loop import run_virtually
from upwash.sim.runtime import ModelRuntime
from upwash.sim.vehicle import Plain
from upwash.sim.world import DroneComputer, Joining

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


class CutWire(Wire):
    """To the drone's own services; once cut, nothing goes over it."""

    def __init__(self) -> None:
        self.cut = False

    async def send(self, server: str, path: str, *, reply: bool, less: bool = False) -> None:
        if self.cut:
            raise Unreachable("the service has crashed")


@dataclass
class Scene:
    """A flight with everything around it."""

    flight: Flight
    autopilot: ModelAutopilot
    journal: MemoryJournal
    wire: CutWire

    def events(self, name: str) -> list[dict[str, Any]]:
        return [event for event in written(self.journal.events) if event["event"] == name]

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
    journal, wire, onboard = MemoryJournal(), CutWire(), Switchboard({})
    journal.begin()
    faults, vehicle = Faults(config.faults), config.vehicle
    pace = pace_in_numbers(vehicle)
    autopilot = kind(
        waypoints(config.mission)[0].position,
        ground_speed_m_s=config.mission.ground_speed_m_s,
        manner=Plain(
            acceleration_m_s2=pace.acceleration_m_s2,
            takeoff_s=pace.lifting_s,
            return_and_land_s=vehicle.return_and_land_s,
        ),
        fault=lambda: faults.now("autopilot"),
        incidents=faults.incidents,
        endurance_s=vehicle.endurance_s,
    )
    computer = DroneComputer(config.services, heat=None, joining=Joining(), noise=0.0, chance=Chance(1))
    dialer = ModelDialer(config.name, onboard, wire)
    ports = Ports(
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
    flight = Flight(mission, config, services={"detector": Detector}, programs=programs, ports=ports)
    return Scene(flight, autopilot, journal, wire)


def assert_ended_in(action: SafeEnd, scene: Scene) -> None:
    (safe_end,) = scene.events("safe_end")
    assert safe_end["action"] == action
    place = scene.autopilot.position
    assert (place.altitude_m > 0) == (action == "hold")
    assert (place.east_m == 0) == (action == "return")
    ended = "left_hovering" if action == "hold" else "landed"
    assert [event["event"] for event in written(scene.journal.events[-2:])] == [ended, "mission_ended"]
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
    assert isinstance(error, ReserveReached) and "reserve of 25 %" in str(error)
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


@pytest.mark.parametrize(("after_s", "asks"), [(0.5, True), (5.0, False)])
def test_ctrl_c_after_the_reserve_asks_for_nothing_more(after_s: float, asks: bool) -> None:
    answers = list[bool]()

    class Asked(ModelAutopilot):
        async def return_home_and_land(self) -> None:
            asyncio.get_running_loop().call_later(after_s, ask)
            await super().return_home_and_land()

    def ask() -> None:
        answers.append(scenes[0].flight.stop("Ctrl-C"))

    scenes = list[Scene]()
    config = scenario(mission={"reserve_percent": 25.0}, vehicle={"endurance_s": 80.0})
    scene, error = fly(config, happens=scenes.append, at_s=0.0, autopilot=Asked)
    assert isinstance(error, ReserveReached)
    assert answers == [asks], "at once it may have been meant for the flight; later it ends the program"
    assert len(scene.events("stopping")) == 1


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


def taken(kind: Literal["pilot", "fail-safe"], from_s: float, to_s: float = 1e6) -> DroneConfig:
    fault = FaultConfig(target="autopilot", kind=kind, from_s=from_s, to_s=to_s)
    return msgspec.structs.replace(scenario(), faults=(fault,))


# From 0 to 10 s it takes off, from 21 to 50 s it flies to waypoint 1, then it takes a photo and calls.
MOMENTS_S = {"in the take-off": 5.0, "in a leg": 40.0, "in a photo": 50.5, "in a call": 55.0}


@pytest.mark.parametrize("owner", ["pilot", "fail-safe"])
@pytest.mark.parametrize("at_s", MOMENTS_S.values(), ids=MOMENTS_S)
def test_a_vehicle_that_somebody_else_takes_is_left_to_them_and_followed_to_the_ground(
    owner: Literal["pilot", "fail-safe"], at_s: float
) -> None:
    scene, error = fly(taken(owner, at_s))
    assert isinstance(error, AutopilotOverruled)
    assert f"{owner} has the vehicle" in str(error)
    assert not scene.events("safe_end")
    names = [event["event"] for event in written(scene.journal.events) if event["event"] != "control"]
    assert names[-3:] == ["left_to_pilot", "stood", "mission_ended"]
    owners = [(event["t"], event["owner"]) for event in scene.events("control")]
    assert owners[:2] == [(0.0, "program"), (at_s, owner)]
    assert {then for _, then in owners[1:]} == {owner}
    assert scene.autopilot.stands and not scene.autopilot.armed


def test_a_mission_that_waits_ends_as_soon_as_a_pilot_takes_the_vehicle() -> None:
    def waits(drone: Drone) -> None:
        drone.autopilot.arm()
        drone.autopilot.takeoff(10)
        drone.autopilot.hover(500.0)

    scene, _ = fly(taken("pilot", 55.0), waits)
    (left,) = scene.events("left_to_pilot")
    assert left["t"] == pytest.approx(55.0, abs=0.1)


class Talkative(ModelAutopilot):
    """Says why a fail-safe took it, as ArduCopter does right after the report that shows it."""

    def listen(self, hear: Callable[[VehicleNews], None]) -> None:
        def heard(news: VehicleNews) -> None:
            hear(news)
            if isinstance(news, Control) and news.owner is Owner.FAILSAFE:
                hear(VehicleSaid(severity=4, text="Battery Failsafe"))

        super().listen(heard)


def test_what_the_vehicle_says_as_it_is_lost_is_told() -> None:
    _, error = fly(taken("fail-safe", 55.0), autopilot=Talkative)
    assert str(error).endswith('the vehicle last said: "Battery Failsafe"')


def test_a_pilot_who_switches_back_to_our_mode_has_not_given_the_vehicle_back() -> None:
    scene, error = fly(taken("pilot", 40.0, 45.0))
    assert isinstance(error, AutopilotOverruled)
    first, *others = [event["owner"] for event in scene.events("control")]
    assert first == "program" and set(others) == {"pilot"}
    assert any("GUIDED" in event["why"] for event in scene.events("control")[1:])
    assert not scene.events("safe_end")


def test_a_pilot_who_flies_before_the_mission_is_armed_is_left_alone() -> None:
    def slow_to_arm(drone: Drone) -> None:
        drone.camera.take_photo()
        survey(drone)

    scene, error = fly(taken("pilot", 0.5), slow_to_arm)
    assert isinstance(error, AutopilotOverruled)
    assert not scene.events("armed") and not scene.events("safe_end")


@pytest.mark.parametrize("action", ACTIONS)
def test_a_pilot_who_takes_over_during_the_safe_end_is_left_alone(action: SafeEnd) -> None:
    config = msgspec.structs.replace(taken("pilot", 42.0), autopilot=AutopilotConfig(on_failure=action))
    scene, error = fly(config, happens=interrupt)
    names = [
        each["event"]
        for each in written(scene.journal.events)
        if each["t"] >= 40.0 and each["event"] != "control"
    ]
    if action == "hold":  # which takes no time
        assert isinstance(error, MissionStopped)
        return
    assert isinstance(error, MissionStopped)
    assert names[-4:] == ["safe_end", "left_to_pilot", "stood", "mission_ended"]
    assert "landed" not in names


def test_ctrl_c_after_a_takeover_sends_nothing_and_ends_following_the_vehicle() -> None:
    scene, error = fly(taken("pilot", 35.0), happens=interrupt)
    assert isinstance(error, AutopilotOverruled)
    names = [event["event"] for event in written(scene.journal.events) if event["t"] >= 35.0]
    assert names[-5:] == ["control", "left_to_pilot", "stopping", "following_ended", "mission_ended"]
    assert not scene.events("safe_end")


def test_a_vehicle_that_has_not_left_the_ground_is_disarmed() -> None:
    def ponder(drone: Drone) -> None:
        drone.autopilot.arm()
        drone.camera.take_photo()
        raise ValueError("the mission has a bug")

    scene, _ = fly(scenario(), ponder)
    assert scene.events("safe_end")[0]["action"] == "disarm"
    assert not scene.autopilot.armed


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
    progress = FlightProgress(["s1"], 4, console)
    for each in scene.journal.events:
        progress.follow(each)
    print_result(scene.result, scene.journal.events, console, paced=False, servers=True)
    told = console.file.getvalue()  # type: ignore[attr-defined]
    assert {"return": "returning to land", "land": "landing where it is", "hold": "stopping"}[action] in told
    assert "1 of 4 waypoints reached, left undone: 1-3" in told
    assert (told.count("hovers where it is, and nobody flies it") == 2) == (action == "hold")


def test_nothing_in_an_event_moves_the_cursor_of_a_persons_terminal() -> None:
    raw = "\x1b[2J\x9b31m\u202e\rall is well"
    console = Console(width=300, file=io.StringIO())
    progress = FlightProgress(["s1"], 4, console)
    for each in (
        event("selected", 1.0, server="s1", before="AVL", after="CHECK", why=raw),
        event("vehicle_said", 1.0, severity=3, text=raw),
        event("remote_failed", 1.0, server="s1", why=raw),
        event("notified", 1.0, message=raw),
    ):
        progress.follow(each)
    told = console.file.getvalue()  # type: ignore[attr-defined]
    assert told.count(r"\x1b[2J\x9b31m\u202e\rall is well") == 4
    assert told.replace("\n", "").isprintable()


class SlyDeadMan(ModelDeadMan):
    """Remembers what it is told, and refuses to watch if it is to."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.refuses = False

    async def watch(self, *, silence_s: float, action: DeadManAction) -> None:
        self.told.append(f"{action} after {silence_s:g} s")
        if self.refuses:
            raise AutopilotRefused("dead man", "it is not there")

    async def release(self) -> None:
        self.told.append("goodbye")


class WatchedAutopilot(ModelAutopilot):
    """With a dead man that is looked at afterwards."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.watcher = SlyDeadMan()

    @property
    def dead_man(self) -> SlyDeadMan:
        return self.watcher


class FaithlessAutopilot(WatchedAutopilot):
    """Its dead man cannot be set."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.watcher.refuses = True


def told_to_dead_man(scene: Scene) -> list[str]:
    assert isinstance(scene.autopilot, WatchedAutopilot)
    return scene.autopilot.watcher.told


def test_the_dead_man_is_set_before_take_off_and_released_at_the_end() -> None:
    scene, error = fly(scenario(autopilot={"dead_man_s": 20.0}), autopilot=WatchedAutopilot)
    assert error is None
    assert told_to_dead_man(scene) == ["return after 20 s", "goodbye"]
    names = [event["event"] for event in written(scene.journal.events)]
    assert names.index("dead_man_set") < names.index("armed")


def test_it_is_released_where_the_flight_ends_early_too() -> None:
    config = scenario(autopilot={"dead_man_s": 20.0, "on_failure": "land"})
    scene, error = fly(config, happens=lambda scene: scene.flight.stop("Ctrl-C"), autopilot=WatchedAutopilot)
    assert isinstance(error, MissionStopped)
    assert told_to_dead_man(scene) == ["land after 20 s", "goodbye"]


def test_it_is_not_released_where_the_vehicle_is_left_hovering() -> None:
    """Nobody else would bring it down: the program is ended while the vehicle does not obey."""
    silent = FaultConfig(target="autopilot", kind="off", from_s=30.0)
    config = msgspec.structs.replace(scenario(autopilot={"dead_man_s": 20.0}), faults=(silent,))
    scene, error = fly(config, happens=lambda scene: scene.flight.stop("Ctrl-C"), autopilot=WatchedAutopilot)
    assert error is not None
    assert told_to_dead_man(scene) == ["return after 20 s"]


def test_without_it_nothing_takes_off_that_was_to_be_watched() -> None:
    scene, error = fly(scenario(autopilot={"dead_man_s": 20.0}), autopilot=FaithlessAutopilot)
    assert isinstance(error, AutopilotRefused) and "it is not there" in str(error)
    assert not scene.events("armed")
    assert told_to_dead_man(scene)[-1] == "goodbye"


def test_a_flight_that_does_not_ask_for_it_does_without() -> None:
    scene, error = fly(scenario(), autopilot=FaithlessAutopilot)
    assert error is None
    assert told_to_dead_man(scene) == ["goodbye"]


def battery_that_raises(after_s: float) -> type[ModelAutopilot]:
    """A vehicle whose battery cannot be read any more from then on, by a defect of ours."""

    class Defective(ModelAutopilot):
        @property
        def battery_percent(self) -> float | None:
            if asyncio.get_running_loop().time() >= after_s:
                raise LookupError("the battery's report has no such field")
            return super().battery_percent

    return Defective


@pytest.mark.parametrize("action", ACTIONS)
def test_a_watch_of_the_reserve_that_fails_ends_the_flight_as_the_reserve_does(action: SafeEnd) -> None:
    config = scenario(
        mission={"reserve_percent": 25.0}, vehicle={"endurance_s": 1000.0}, autopilot={"on_failure": action}
    )
    scene, error = fly(config, autopilot=battery_that_raises(60.0))
    assert isinstance(error, ReserveReached) and "a defect has ended the watch of the reserve" in str(error)
    (failed,) = scene.events("battery_watch_failed")
    assert failed["t"] == pytest.approx(60.0, abs=1.0)
    assert "no such field" in failed["why"] and "Traceback" in failed["trace"]
    assert_ended_in(action, scene)


def test_a_watch_of_the_reserve_that_fails_on_the_way_down_is_told_and_ends_nothing() -> None:
    well, _ = fly(scenario(mission={"reserve_percent": 25.0}, vehicle={"endurance_s": 1000.0}))
    (returning,) = well.events("returning")
    config = scenario(mission={"reserve_percent": 25.0}, vehicle={"endurance_s": 1000.0})
    scene, error = fly(config, autopilot=battery_that_raises(returning["t"] + 1.0))
    assert error is None
    assert scene.events("battery_watch_failed") and not scene.events("stopping")
