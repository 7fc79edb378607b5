"""A flight whose program is killed and started again, on virtual time."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.events import event

from upwash import Drone
from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.core.geo import Position
from upwash.drone.flight import Flight, Ports
from upwash.drone.networks import NoNetwork
from upwash.drone.resumption import objects_acted_on, order_begun, waypoints_done
from upwash.errors import AutopilotOverruled, AutopilotRefused, InstanceError, MissionFailed, UsageError
from upwash.eventlog import schema
from upwash.eventlog.results import RunResult, read_result
from upwash.eventlog.schema import Event
from upwash.missions.bundled import load_services
from upwash.missions.survey import survey
from upwash.ports import Camera, InstanceSpec
from upwash.rpc.service import spec_of
from upwash.services import Detector
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.camera import ModelCamera
from upwash.sim.chance import Chance
from upwash.sim.journal import MemoryJournal
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.loop import run_virtually
from upwash.sim.runtime import ModelRuntime
from upwash.sim.vehicle import Plain
from upwash.sim.world import DroneComputer, Joining

# Take-off is over at 10 s, waypoints are 20 m and 9 s apart, and photo and call of each take 11 s.
PLACES = [[0, 0], [20, 0], [40, 0], [60, 0]]
ALTITUDE_M = 20.0


def scenario(**mission: Any) -> DroneConfig:
    document = {
        "mission": {"waypoints_m": PLACES, "altitude_m": ALTITUDE_M, **mission},
        "service": [{"name": "detector", "local_call_s": {"light": 3.0, "heavy": 10.0}}],
    }
    return drone_config(document, Path("scenario.toml"))


def at_once(config: DroneConfig) -> DroneConfig:
    """The same, and no act is put off."""
    policy = msgspec.structs.replace(config.policy, act_within_s=0.0)
    return msgspec.structs.replace(config, policy=policy)


class Part:
    """One life of the program."""

    def __init__(self, earlier: Sequence[Event], found_at: Position | None) -> None:
        self.events: list[Event] = list(earlier)
        self.position = found_at
        self.error: Exception | None = None

    @property
    def result(self) -> RunResult:
        return read_result(self.events)

    def names(self) -> list[str]:
        return [event.kind for event in self.events]


def fly(
    config: DroneConfig,
    *,
    after: Part | None = None,
    killed_at_s: float = 1e6,
    mission: Callable[[Drone], None] = survey,
    autopilot: Callable[..., ModelAutopilot] = ModelAutopilot,
    runtime: type[ModelRuntime] = ModelRuntime,
    camera: Callable[..., Camera] = ModelCamera,
    shows: Sequence[Position] = (),
    stopped_at_s: float | None = None,
) -> Part:
    """Flies from the beginning, or on from where an earlier part was killed, until it ends or is killed.

    The photos of the places that it `shows` have something to see. At `stopped_at_s` a person ends the mission.
    """
    earlier = after.events if after else []
    part = Part(earlier, after.position if after else None)
    opened = event("log_resumed" if after else "log_opened", part.result.mission_time_s)

    async def live() -> None:
        journal, onboard = MemoryJournal(), Switchboard({})
        journal.begin()
        flying = part.position is not None and part.position.altitude_m > 0
        vehicle = autopilot(
            Position(0.0, 0.0),
            ground_speed_m_s=4.0,
            manner=Plain(acceleration_m_s2=1.0, takeoff_s=10.0, return_and_land_s=16.0),
            hovers_at=part.position if flying else None,
        )
        dialer = ModelDialer(config.name, onboard)
        computer = DroneComputer(config.services, heat=None, joining=Joining(), noise=0.0, chance=Chance(1))
        ports = Ports(
            autopilot=vehicle,
            networks=[NoNetwork()],
            dialer=dialer,
            onboard_dialer=dialer,
            onboard_runtime=runtime({"detector": spec_of(Detector)}, computer, onboard),
            camera=camera(photo_s=1.0, events=shows, in_flight=config.mission.photos is not None),
            notifier=journal,
            journal=journal,
        )
        flight = Flight(
            mission,
            config,
            services={"detector": Detector},
            programs={"detector": load_services(config.services)["detector"].program},
            ports=ports,
            done=waypoints_done(earlier, config) if after else None,
            order=order_begun(earlier, config) if after else None,
            objects=objects_acted_on(earlier) if after else None,
        )
        life = asyncio.create_task(flight.run())
        if stopped_at_s is not None:
            asyncio.get_running_loop().call_at(stopped_at_s, flight.stop, "Ctrl-C")
        await asyncio.wait([life], timeout=killed_at_s)
        part.events = [
            *earlier,
            opened,
            *(msgspec.structs.replace(each, t=each.t + opened.t) for each in journal.events),
        ]
        part.position = vehicle.position
        if life.done() and isinstance(error := life.exception(), Exception):
            part.error = error

    run_virtually(live())
    return part


def places(part: Part) -> list[int | None]:
    return [call.waypoint for call in part.result.calls]


@pytest.mark.parametrize(
    "killed_at_s", [0.0, 0.1, 5.0, 10.5, 11.5, 20.9, 21.1, 25.0, 30.5, 33.0, 41.5, 70.5, 82.0, 90.0]
)
def test_killed_at_any_moment_it_takes_up_the_plan_after_the_last_result(killed_at_s: float) -> None:
    first = fly(scenario(), killed_at_s=killed_at_s)
    assert "mission_completed" not in first.names()
    had = places(first)
    both = fly(scenario(), after=first)
    assert both.error is None
    assert places(both) == [0, 1, 2, 3], "one result for every photo, none twice"
    assert places(both)[: len(had)] == had
    assert both.result.completed
    assert (both.result.waypoints, both.result.undone) == (4, [])
    assert both.position is not None and both.position.altitude_m == 0.0


@pytest.mark.parametrize(
    ("stay_or_go", "killed_at_s"),
    [
        (manner, float(at_s))
        for manner, over_s in (("stay", 106), ("go", 96))
        for at_s in range(10, over_s, 3)
    ],
)
def test_killed_at_any_moment_no_answer_and_nothing_that_it_demands_is_lost(
    stay_or_go: str, killed_at_s: float
) -> None:
    config = scenario(action_s=5.0)
    policy = msgspec.structs.replace(config.policy, stay_or_go=stay_or_go)
    config = msgspec.structs.replace(config, policy=policy)
    shows = [Position(east_m, north_m) for east_m, north_m in PLACES[1:3]]
    both = fly(config, after=fly(config, killed_at_s=killed_at_s, shows=shows), shows=shows)
    assert both.error is None
    assert both.result.completed
    acted = Counter(each.waypoint for each in both.events if isinstance(each, schema.Acted))
    assert acted == {1: 1, 2: 1}, "once each in the log"
    answered = {each.waypoint for each in both.events if isinstance(each, schema.AnswerTaken)}
    assert answered == {0, 1, 2, 3}


@pytest.mark.parametrize(("killed_at_s", "takeoffs"), [(0.0, 1), (5.0, 0), (33.0, 1), (90.0, 1)])
def test_a_vehicle_in_the_air_neither_arms_nor_takes_off_again(killed_at_s: float, takeoffs: int) -> None:
    both = fly(scenario(), after=fly(scenario(), killed_at_s=killed_at_s))
    assert both.names().count("took_off") == takeoffs
    assert both.names().count("armed") == 1


def test_killed_while_it_climbs_it_climbs_on_before_it_flies_away() -> None:
    seen: list[float] = []

    class Seen(ModelAutopilot):
        async def goto(self, position: Position) -> None:
            await super().goto(position)
            seen.append(self.position.altitude_m)

    fly(scenario(), after=fly(scenario(), killed_at_s=5.0), autopilot=Seen)
    assert seen == [pytest.approx(ALTITUDE_M)] * (1 + len(PLACES)), "the climb, then the plan"


def test_it_is_killed_again_and_again() -> None:
    part = fly(scenario(), killed_at_s=15.0)
    for _ in range(12):
        part = fly(scenario(), after=part, killed_at_s=13.0)
    part = fly(scenario(), after=part)
    assert part.result.completed
    assert places(part) == [0, 1, 2, 3]


def test_with_every_result_there_it_only_comes_down() -> None:
    whole = fly(scenario())
    last_call = max(each.t for each in whole.events if each.kind == "call")
    both = fly(scenario(), after=fly(scenario(), killed_at_s=last_call + 5.0))
    assert both.names()[-5:] == ["mission_started", "returning", "landed", "disarmed", "mission_completed"]


def test_with_every_result_there_a_landed_vehicle_stays_on_the_ground() -> None:
    whole = fly(scenario())
    landed = next(each.t for each in whole.events if each.kind == "landed")

    def forget(drone: Drone) -> None:
        survey(drone)
        raise ValueError("a bug in the mission's last words")

    first = fly(scenario(), mission=forget)
    assert isinstance(first.error, MissionFailed) and first.result.calls and landed > 0
    both = fly(scenario(), after=first)
    assert both.error is None and both.result.completed
    assert both.names().count("took_off") == 1


def test_a_completed_mission_is_not_taken_up() -> None:
    with pytest.raises(UsageError, match="was completed"):
        fly(scenario(), after=fly(scenario()))


def test_a_mission_that_was_ended_early_can_be_taken_up_on_the_ground() -> None:
    def give_up(drone: Drone) -> None:
        drone.autopilot.arm()
        drone.autopilot.takeoff(drone.altitude_m)
        detector = drone.service(Detector)
        for waypoint in drone.plan[:2]:
            drone.autopilot.goto(waypoint)
            detector.process_photo(drone.camera.take_photo(), mode="heavy")
        raise ValueError("the battery is nearly empty")

    first = fly(scenario(), mission=give_up)
    assert "landed" in first.names()
    both = fly(scenario(), after=first)
    assert both.error is None and places(both) == [0, 1, 2, 3]
    assert both.names().count("took_off") == 2


def test_a_vehicle_that_somebody_else_flies_is_left_alone() -> None:
    class Taken(ModelAutopilot):
        async def in_the_air(self) -> bool:
            raise AutopilotOverruled("start", "the vehicle is in mode RTL")

        async def arm(self) -> None:
            raise AssertionError("nothing must be sent")

        goto = return_home_and_land = land = hold = arm  # type: ignore[assignment]

    both = fly(scenario(), after=fly(scenario(), killed_at_s=33.0), autopilot=Taken)
    assert isinstance(both.error, AutopilotOverruled)
    assert "safe_end" not in both.names()


def test_a_mission_is_not_begun_in_the_air() -> None:
    flying = fly(scenario(), killed_at_s=33.0)

    class Flying(ModelAutopilot):
        async def in_the_air(self) -> bool:
            return True

    refused = fly(scenario(), autopilot=Flying)
    assert isinstance(refused.error, AutopilotRefused)
    assert "--resume" in str(refused.error)
    assert flying.position is not None


def test_services_that_do_not_start_end_a_flight_that_was_taken_up_safely() -> None:
    class Broken(ModelRuntime):
        async def start(self, spec: InstanceSpec, *, called: Callable[[str], None], **_: Any) -> Any:
            raise InstanceError("no model")

    both = fly(scenario(), after=fly(scenario(), killed_at_s=33.0), runtime=Broken)
    assert isinstance(both.error, InstanceError)
    assert both.names()[-3:] == ["safe_end", "landed", "mission_ended"]
    assert both.position is not None and both.position.altitude_m == 0.0


def test_what_is_left_is_flown_in_the_order_that_was_begun() -> None:
    first = fly(scenario(order=1), killed_at_s=65.0)
    assert places(first) == [3, 2]
    second = fly(scenario(), after=first)
    assert second.error is None
    assert places(second) == [3, 2, 1, 0]
