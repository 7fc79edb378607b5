"""Rows without stops, flown by the driver with a stand-in of either autopilot: places of photos, times and ends."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pytest
from tests.ports.memory import HOME, Bench, bench, driven
from tests.ports.steps import take_off
from tests.scenarios import scenario
from tests.surveys import SPOTS, transects, written

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import read_drone_config
from upwash.config.places import waypoints
from upwash.core.geo import Position, Velocity
from upwash.drone.flight import Flight, Ports
from upwash.drone.networks import NoNetwork
from upwash.errors import AutopilotLost, AutopilotOverruled
from upwash.eventlog import schema
from upwash.eventlog.results import RunResult, read_result
from upwash.lab.run import simulate
from upwash.mavlink.px4 import Mode
from upwash.missions.survey import survey
from upwash.ports import Photo, Program
from upwash.rpc.service import spec_of
from upwash.services import Detector
from upwash.sim.camera import ModelCamera
from upwash.sim.chance import Chance
from upwash.sim.journal import MemoryJournal
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.loop import run_virtually
from upwash.sim.runtime import ModelRuntime
from upwash.sim.vehicle import FlightModel
from upwash.sim.world import DroneComputer, Joining
from upwash.vehicle.ardupilot import airframe as arducopter
from upwash.vehicle.ardupilot.settings import CopterMode, VehicleSettings
from upwash.vehicle.body.copter import FaultKind
from upwash.vehicle.px4 import airframe as px4
from upwash.vehicle.px4.inputs import Sticks
from upwash.vehicle.px4.settings import Px4Settings

Firmware = Literal["arducopter", "px4"]
ROWS_M = [[0, 0], [80, 0], [80, 20], [0, 20], [0, 40], [80, 40]]
DEMANDING, LAST = 7, 14  # in the middle of the second row
ROW_ENDS = (0, 4, 5, 9, 10, 14)
HEARD_S = 0.2  # after its change, a mode is reported


def config_of(
    firmware: Firmware, speed_m_s: float, *, local_s: float = 1.5, at_most: int = 100
) -> DroneConfig:
    home = {"latitude_deg": HOME.latitude_deg, "longitude_deg": HOME.longitude_deg}
    rows = {"grid": None, "waypoints_m": ROWS_M, "photos": {"every_m": 20.0, "at_most": at_most}}
    return scenario(
        mission={"home": home, "ground_speed_m_s": speed_m_s, "action_s": 5.0, **rows},
        event={"every": 100, "offset": DEMANDING},
        vehicle={"profile": firmware},
        policy={"name": "local-only", "act_within_s": 0.0},
        service=[{"name": "detector", "local_call_s": {"light": 1.0, "heavy": local_s}}],
    )


@dataclass(frozen=True)
class Shot:
    """Where the vehicle truly was at a photo."""

    place: Position
    velocity: Velocity
    heading_deg: float


@dataclass
class Camera:
    """Photographs the events, and notes the true places of the vehicle; `at` happens at the photo of that number."""

    sky: Bench
    events: ModelCamera
    at: dict[int, Callable[[Bench], object]]
    shots: list[Shot] = field(default_factory=list)

    async def take_photo(self, at: Position) -> Photo:
        copter, now_s = self.sky.copter, self.sky.now_s
        copter.advance(now_s)
        self.shots.append(Shot(copter.position(now_s), copter.velocity(now_s), copter.heading_deg(now_s)))
        if (happens := self.at.get(len(self.shots) - 1)) is not None:
            happens(self.sky)
        return await self.events.take_photo(at)


@dataclass(frozen=True)
class Flown:
    sky: Bench
    shots: list[Shot]
    journal: MemoryJournal
    error: Exception | None

    @property
    def result(self) -> RunResult:
        return read_result(self.journal.events)

    def of(self, kind: type[schema.Event]) -> list[Any]:
        return [event for event in self.journal.events.as_read() if isinstance(event, kind)]


def fly(config: DroneConfig, **at: Callable[[Bench], object]) -> Flown:
    """Flies the mission; `photo3=...` happens at photo 3."""
    happens = {int(name.removeprefix("photo")): what for name, what in at.items()}

    async def flown() -> Flown:
        async with (
            bench(vehicle_of(config)) as sky,
            sky.program(ground_speed_m_s=config.mission.ground_speed_m_s) as autopilot,
        ):
            spots = waypoints(config.mission)
            events = ModelCamera(
                photo_s=config.camera.photo_s, events=[spots[DEMANDING].position], in_flight=True
            )
            camera, journal, onboard = Camera(sky, events, happens), MemoryJournal(), Switchboard({})
            journal.begin()
            computer = DroneComputer(
                config.services, heat=None, joining=Joining(), noise=0.0, chance=Chance(1)
            )
            dialer = ModelDialer(config.name, onboard)
            ports = Ports(
                autopilot=autopilot,
                networks=[NoNetwork()],
                dialer=dialer,
                onboard_dialer=dialer,
                onboard_runtime=ModelRuntime({"detector": spec_of(Detector)}, computer, onboard),
                camera=camera,
                notifier=journal,
                journal=journal,
            )
            programs = {"detector": Program("upwash.services:Detector")}
            flight = Flight(survey, config, services={"detector": Detector}, programs=programs, ports=ports)
            try:
                await flight.run()
            except Exception as error:  # noqa: BLE001 - the test looks at it
                return Flown(sky, camera.shots, journal, error)
            return Flown(sky, camera.shots, journal, None)

    return run_virtually(flown())


def vehicle_of(config: DroneConfig) -> VehicleSettings | Px4Settings:
    assert config.mission.home is not None
    home = config.mission.home.place
    if config.vehicle.profile == "px4":
        return Px4Settings(home, home_altitude_m=488.0, parameters={"COM_OBL_RC_ACT": 3.0})
    return VehicleSettings(home, armable_after_s=0.0)


@pytest.mark.parametrize("speed_m_s", [4.0, 8.0])
@pytest.mark.parametrize("firmware", ["arducopter", "px4"])
def test_rows_are_flown_as_simulated(firmware: Firmware, speed_m_s: float) -> None:
    config = config_of(firmware, speed_m_s)
    flown, simulated = fly(config), simulate(config)
    assert flown.result.completed and simulated.result.completed, flown.error
    assert flown.result.mission_time_s == pytest.approx(simulated.result.mission_time_s, rel=0.03)

    spots = waypoints(config.mission)
    assert len(flown.shots) == len(spots)
    for number, (shot, spot) in enumerate(zip(flown.shots, spots, strict=True)):
        at = shot.place.east_m, shot.place.north_m
        most_m = 1.1 if number in ROW_ENDS else 0.5  # there it rests, as at a stop
        assert math.dist(at, (spot.position.east_m, spot.position.north_m)) < most_m, number
        if number in ROW_ENDS:
            assert shot.velocity.speed_m_s < 0.6, number
        if number not in ROW_ENDS and number != DEMANDING + 1:
            assert shot.velocity.speed_m_s > 0.85 * speed_m_s, number
            along_deg = 270.0 if shot.velocity.east_m_s < 0 else 90.0
            assert math.remainder(shot.heading_deg - along_deg, 360.0) == pytest.approx(0.0, abs=10.0)
    (acted,) = flown.of(schema.Acted)
    assert acted.waypoint == DEMANDING
    (told,) = flown.of(schema.Notified)
    assert told.at == spots[DEMANDING].position
    stops = [event.waypoint for event in flown.of(schema.Arrived) if not event.passing]
    assert sorted(stops) == sorted([*ROW_ENDS, DEMANDING])


@pytest.mark.parametrize("speed_m_s", [4.0, 8.0])
@pytest.mark.parametrize(("firmware", "manner"), [("arducopter", arducopter), ("px4", px4)])
def test_a_hold_in_flight_is_as_simulated(firmware: Firmware, manner: FlightModel, speed_m_s: float) -> None:
    async def held() -> tuple[float, float]:
        async with driven(vehicle_of(config_of(firmware, speed_m_s)), ground_speed_m_s=speed_m_s) as (
            sky,
            autopilot,
        ):
            await take_off(autopilot)
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(20.0):
                    await autopilot.goto(Position(500.0, 0.0, 5.0))
            begun_s, begun_m = sky.now_s, autopilot.position.east_m
            await autopilot.hold()
            return sky.now_s - begun_s, autopilot.position.east_m - begun_m

    took_s, way_m = run_virtually(held())
    phases = manner.hold(Position(0.0, 0.0, 5.0), Velocity(speed_m_s))
    assert took_s == pytest.approx(manner.arrival_s(phases), rel=0.1)
    assert way_m == pytest.approx(max(phase.end.east_m for phase in phases), rel=0.35)


def later(after_s: float, what: Callable[[Bench], object]) -> Callable[[Bench], object]:
    return lambda sky: asyncio.get_running_loop().call_later(after_s, what, sky)


def pilot_lands(sky: Bench) -> None:
    if isinstance(sky.copter.settings, Px4Settings):
        sky.copter.move_sticks(sky.now_s, Sticks())
        sky.copter.set_mode(Mode.LAND)
    else:
        sky.copter.change_mode(sky.now_s, CopterMode.LAND)


def silent_for(silent_s: float) -> Callable[[Bench], None]:
    def falls_silent(sky: Bench) -> None:
        sky.cut = True
        later(silent_s, speaks)(sky)

    def speaks(sky: Bench) -> None:
        sky.cut = False

    return falls_silent


@pytest.mark.parametrize("firmware", ["arducopter", "px4"])
def test_a_pilot_takes_it_on_a_row_with_answers_open(firmware: Firmware) -> None:
    taken_s = []

    def takes(sky: Bench) -> None:
        pilot_lands(sky)
        taken_s.append(sky.now_s + HEARD_S)

    flown = fly(config_of(firmware, 4.0, local_s=60.0), photo6=later(1.0, takes))
    assert isinstance(flown.error, AutopilotOverruled), flown.error
    assert "the program has lost the vehicle" in str(flown.error)
    assert flown.sky.commands(*taken_s) == []
    assert flown.sky.setpoints(*taken_s) == 0
    assert flown.result.not_looked_at == [*range(7)]
    assert flown.result.undone == [*range(7, 15)]


@pytest.mark.parametrize("firmware", ["arducopter", "px4"])
@pytest.mark.parametrize("when", ["brake", "detour", "action", "wait"])
def test_a_pilot_takes_it_off_its_row_and_gets_it(firmware: Firmware, when: str) -> None:
    """After a photo with a demand: in the brake, on the way back, in the action; and in a wait for answers."""
    after_s = {"brake": 3.0, "detour": 7.0, "action": 15.0, "wait": 10.0}[when]
    taken_s: list[float] = []

    def takes(sky: Bench) -> None:
        pilot_lands(sky)
        taken_s.append(sky.now_s + HEARD_S)

    config = config_of(firmware, 4.0)
    if when == "wait":
        config = config_of(firmware, 4.0, local_s=60.0, at_most=3)
    flown = fly(config, **{"photo2" if when == "wait" else f"photo{DEMANDING}": later(after_s, takes)})
    assert isinstance(flown.error, AutopilotOverruled), flown.error
    assert flown.sky.commands(*taken_s) == []
    assert flown.sky.setpoints(*taken_s) == 0
    was_there = {
        "brake": [event.waypoint for event in flown.of(schema.Demanded)] == [DEMANDING],
        "detour": [event.back for event in flown.of(schema.SetOff)][-1],
        "action": [event.waypoint for event in flown.of(schema.Arrived)][-1] == DEMANDING,
        "wait": [event.waiting for event in flown.of(schema.PhotosWait)] == [3],
    }
    assert was_there[when]
    assert not flown.of(schema.Acted)


@pytest.mark.parametrize("firmware", ["arducopter", "px4"])
def test_a_link_that_stays_silent_on_a_row_ends_the_flight(firmware: Firmware) -> None:
    flown = fly(config_of(firmware, 4.0, local_s=60.0), photo6=silent_for(math.inf))
    assert isinstance(flown.error, AutopilotLost), flown.error
    assert [event.action for event in flown.of(schema.SafeEnd)] == ["return"]
    answered = [event.waypoint for event in flown.of(schema.AnswerTaken)]
    assert answered == [0, 1], "those that were there before the link counted as lost"
    assert flown.result.not_looked_at == [*range(2, 7)]


def test_a_px4_that_hears_nothing_on_a_row_goes_home_and_is_left_alone() -> None:
    """It leaves OFFBOARD a second after the last setpoint."""
    taken_s: list[float] = []

    def falls_silent(sky: Bench) -> None:
        taken_s.append(sky.now_s + 5.0)
        silent_for(5.0)(sky)

    flown = fly(config_of("px4", 4.0), photo6=falls_silent)
    assert isinstance(flown.error, AutopilotOverruled), flown.error
    assert "fail-safe" in str(flown.error)
    assert flown.sky.commands(*taken_s) == []
    assert flown.sky.setpoints(*taken_s) == 0
    assert [event.waypoint for event in flown.of(schema.Arrived)][-1] == 6


@pytest.mark.parametrize("lasts_s", [6.0, 12.0, 40.0])
@pytest.mark.parametrize("photo", [4, 6, DEMANDING])
def test_no_spot_counts_while_the_vehicle_doubts_its_gps(photo: int, lasts_s: float) -> None:
    """It doubts its receiver after 1.4 s, and takes the glitch of 56 m for true after 10.2 s."""
    doubted_s = []

    def glitches(sky: Bench) -> None:
        sky.fail(FaultKind.GLITCH)
        doubted_s.append(sky.now_s + 2.5)
        later(lasts_s, lambda sky: sky.mend(FaultKind.GLITCH))(sky)

    config = config_of("arducopter", 4.0)
    flown = fly(config, **{f"photo{photo}": glitches})
    assert flown.result.completed, flown.error
    for shot, spot in zip(flown.shots, waypoints(config.mission), strict=True):
        at = shot.place.east_m, shot.place.north_m
        assert math.dist(at, (spot.position.east_m, spot.position.north_m)) < 1.1, spot.index
    (since_s,) = doubted_s
    assert not [event for event in flown.of(schema.Arrived) if since_s < event.t < since_s + lasts_s - 2.5]


@pytest.mark.parametrize("silent_s", [4.0, 5.0, 8.0])
def test_spots_that_were_passed_in_a_silence_are_flown_back_to(silent_s: float) -> None:
    config = config_of("arducopter", 8.0)
    flown = fly(config, photo6=silent_for(silent_s))
    assert flown.result.completed, flown.error
    for number, (shot, spot) in enumerate(zip(flown.shots, waypoints(config.mission), strict=True)):
        at = shot.place.east_m, shot.place.north_m
        assert math.dist(at, (spot.position.east_m, spot.position.north_m)) < 1.0, number


@pytest.mark.parametrize("firmware", ["arducopter", "px4"])
def test_a_survey_is_flown_as_simulated(firmware: Firmware, tmp_path: Path) -> None:
    """With turn-arounds, in which there is no photo; the eighth photo has a demand."""
    more = f'[vehicle]\nprofile = "{firmware}"\n[event]\nevery = 100\noffset = {DEMANDING}\n'
    file = written(
        tmp_path,
        transects(),
        photo_s=0.1,
        heavy_s=1.5,
        more=more + '[policy]\nname = "local-only"\nact_within_s = 0.0',
    )
    config = read_drone_config(file)
    flown, simulated = fly(config), simulate(config)
    assert flown.result.completed and simulated.result.completed, flown.error
    assert flown.result.mission_time_s == pytest.approx(simulated.result.mission_time_s, rel=0.03)
    assert len(flown.shots) == len(SPOTS)
    for shot, spot in zip(flown.shots, SPOTS, strict=True):
        assert math.dist((shot.place.east_m, shot.place.north_m), spot) < 0.3
        assert shot.velocity.speed_m_s > 3.5, "at speed from the first photo on"
