"""What others do to a simulated vehicle, and what it does by itself, as the program hears of it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from tests.played import played
from tests.scenarios import fault, scenario

from upwash.config.world import FaultConfig
from upwash.core.geo import Position, distance_m, ground_distance_m
from upwash.core.vehicle.control import Owner
from upwash.errors import AutopilotError, AutopilotOverruled, AutopilotTimeout
from upwash.eventlog import schema
from upwash.eventlog.schema import HomeMoved, PositionDoubted
from upwash.lab.observer import Observation
from upwash.lab.run import simulate_fleet
from upwash.ports import VehicleNews
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.loop import run_virtually
from upwash.sim.vehicle import FlightModel, Plain
from upwash.vehicle.ardupilot import airframe as arducopter

THERE = Position(100.0, 0.0, 20.0)  # 25 s away by a leg at 5 m/s, from 5 s on
PLAIN = Plain(acceleration_m_s2=1.0, takeoff_s=5.0, return_and_land_s=10.0)


class Flight:
    """A vehicle in the air, to which these incidents happen, and what its program hears."""

    def __init__(
        self,
        *incidents: FaultConfig,
        fault: Callable[[], FaultConfig | None] = lambda: None,
        manner: FlightModel = PLAIN,
    ):
        self.commands: list[str] = []
        self.taken: list[str] = []
        self.news: list[VehicleNews] = []
        self.off_m: list[float] = []
        self.unheard = 0
        self.autopilot = ModelAutopilot(
            Position(0.0, 0.0),
            ground_speed_m_s=5.0,
            manner=manner,
            fault=fault,
            incidents=incidents,
            observe=self._observe,
        )
        self.autopilot.listen(self.news.append)

    def _observe(self, event: str, command: str = "", by: str = "", off_m: float = 0.0) -> None:
        match event:
            case "commanded":
                self.commands.append(command)
            case "taken":
                self.taken.append(by)
            case "reached":
                self.off_m.append(off_m)
            case "jumped_unheard":
                self.unheard += 1

    async def take_off(self) -> ModelAutopilot:
        await self.autopilot.in_the_air()
        await self.autopilot.claim(resumes=False)
        await self.autopilot.ready()
        await self.autopilot.arm()
        await self.autopilot.takeoff(20.0)
        return self.autopilot


def befalls(kind: str, from_s: float, to_s: float = float("inf"), **more: object) -> FaultConfig:
    return FaultConfig(target="autopilot", kind=kind, from_s=from_s, to_s=to_s, **more)  # type: ignore[arg-type]


def now_s() -> float:
    return asyncio.get_running_loop().time()


def fly(story: Callable[[], Awaitable[None]]) -> None:
    async def told() -> None:
        await story()

    run_virtually(told())


@played(fly)
async def test_a_ground_station_that_sends_it_elsewhere_has_it_and_no_command_follows() -> None:
    flight = Flight(befalls("diverted", 12.0, moved_m=(0.0, 30.0, -5.0)))
    autopilot = await flight.take_off()
    with pytest.raises(AutopilotOverruled, match="sent to"):
        await autopilot.goto(THERE)
    sent = len(flight.commands)
    assert (autopilot.control.owner, flight.taken) == (Owner.GROUND_STATION, ["ground station"])
    here = autopilot.position
    await asyncio.sleep(15.0)
    assert distance_m(autopilot.position, Position(here.east_m, 30.0, 15.0)) < 0.01
    with pytest.raises(AutopilotOverruled):
        await autopilot.hold()
    await autopilot.stood()
    assert len(flight.commands) == sent


@pytest.mark.parametrize("from_s", [0.0, 2.0])
@played(fly)
async def test_nobody_is_sent_anywhere_on_the_ground(*, from_s: float) -> None:
    flight = Flight(befalls("diverted", from_s), befalls("home", from_s))
    await asyncio.sleep(3.0)
    autopilot = await flight.take_off()
    await autopilot.goto(THERE)
    assert autopilot.control.is_ours and not flight.taken
    assert autopilot.energy.home == Position(0.0, 0.0)


@played(fly)
async def test_a_home_that_is_moved_changes_no_altitude_and_is_where_it_returns_to() -> None:
    flight = Flight(befalls("home", 12.0, moved_m=(40.0, 50.0, -12.0)))
    autopilot = await flight.take_off()
    await autopilot.goto(THERE)
    assert autopilot.position.altitude_m == pytest.approx(20.0)
    await autopilot.goto(Position(0.0, 0.0, 15.0))
    assert autopilot.position.altitude_m == pytest.approx(15.0)
    told = [each for each in flight.news if isinstance(each, HomeMoved)]
    assert told == [HomeMoved.of(Position(40.0, 50.0, -12.0))]
    assert autopilot.energy.home == Position(40.0, 50.0)
    await autopilot.return_home_and_land()
    assert autopilot.position == Position(40.0, 50.0) and autopilot.stands


@played(fly)
async def test_in_doubt_nothing_counts_as_arrived_and_after_the_jump_back_the_leg_ends_where_it_should() -> (
    None
):
    flight = Flight(befalls("jump", 12.0, 40.0, moved_m=(30.0, -40.0, 0.0)))
    autopilot = await flight.take_off()
    leg = asyncio.create_task(autopilot.goto(THERE))
    await asyncio.sleep(34.0)
    assert distance_m(autopilot.position, THERE) < 0.01, "where it reports to be"
    assert ground_distance_m(autopilot.true_position, THERE) == pytest.approx(50.0, abs=0.1)
    assert not leg.done() and not flight.off_m
    await leg
    assert flight.off_m == [pytest.approx(0.0, abs=0.01)]
    doubts = [each.jumped_m for each in flight.news if isinstance(each, PositionDoubted)]
    assert doubts == [pytest.approx(50.0), pytest.approx(0.0, abs=1e-6)]


@played(fly)
async def test_a_position_that_never_jumps_back_ends_the_leg_in_words_that_name_the_jump() -> None:
    flight = Flight(befalls("jump", 12.0, moved_m=(30.0, -40.0, 0.0)))
    autopilot = await flight.take_off()
    with pytest.raises(AutopilotTimeout, match=r"its reported position jumped 50 m, farther than it can fly"):
        await autopilot.goto(THERE)
    assert not flight.off_m
    await autopilot.return_home_and_land()
    assert autopilot.stands and autopilot.control.is_ours


@played(fly)
async def test_it_hovers_where_it_believes_to_be_and_a_landing_ends_on_the_ground_below() -> None:
    flight = Flight(befalls("jump", 7.0, 9.0, moved_m=(30.0, -40.0, 0.0)), befalls("jump", 60.0))
    autopilot = await flight.take_off()
    await asyncio.sleep(45.0)
    assert distance_m(autopilot.position, Position(0.0, 0.0, 20.0)) < 0.01
    await asyncio.sleep(5.0)
    await autopilot.land()
    assert autopilot.stands and autopilot.position == Position(40.0, 30.0)
    assert autopilot.true_position == Position(0.0, 0.0)


@played(fly)
async def test_a_jump_within_a_silence_is_not_heard() -> None:
    silent: list[FaultConfig] = []
    flight = Flight(befalls("jump", 12.0), fault=lambda: silent[0] if silent else None)
    autopilot = await flight.take_off()
    leg = asyncio.create_task(autopilot.goto(THERE))
    await asyncio.sleep(1.0)
    silent.append(befalls("off", 0.0))
    await asyncio.sleep(10.0)
    silent.clear()
    await leg
    assert flight.unheard == 1 and flight.off_m == [pytest.approx(50.0)]


@played(fly)
async def test_a_leg_that_a_pilot_stopped_and_gave_back_unheard_is_flown_to_its_end() -> None:
    silent = befalls("off", 0.0)
    flight = Flight(befalls("pilot", 8.0, 9.0), fault=lambda: silent if 7.0 < now_s() < 10.0 else None)
    autopilot = await flight.take_off()
    await autopilot.goto(Position(30.0, 0.0, 20.0))
    assert flight.off_m == [pytest.approx(0.0, abs=0.01)]


@pytest.mark.parametrize(
    ("verb", "kind", "to_s", "owner"),
    [
        ("goto", "pilot", 60.0, Owner.PILOT),
        ("goto", "diverted", 60.0, Owner.GROUND_STATION),
        ("goto", "fail-safe", 60.0, Owner.FAILSAFE),
        ("goto", "restart", 8.5, Owner.UNKNOWN),
        ("return", "pilot", 9.0, Owner.PILOT),  # in GUIDED again, where RTL was commanded
        ("arm", "pilot", 9.0, Owner.PILOT),  # armed by the pilot
    ],
)
@played(fly)
async def test_what_others_leave_behind_after_a_silence_is_heard(
    *, verb: str, kind: str, to_s: float, owner: Owner
) -> None:
    silent = befalls("off", 0.0)
    flight = Flight(befalls(kind, 8.0, to_s), fault=lambda: silent if 7.0 < now_s() < 10.0 else None)
    autopilot = flight.autopilot
    with pytest.raises(AutopilotOverruled):
        if verb == "arm":
            await autopilot.claim(resumes=False)
            await asyncio.sleep(11.0)
            await autopilot.ready()
            await autopilot.arm()
        else:
            await flight.take_off()
            await (autopilot.goto(THERE) if verb == "goto" else autopilot.return_home_and_land())
    assert autopilot.control.owner is owner
    assert flight.commands[-1:] == ([] if verb == "arm" else [verb])


@pytest.mark.parametrize("verb", ["take-off", "turn"])
@played(fly)
async def test_what_a_pilot_stopped_and_gave_back_unheard_does_not_count_as_done(*, verb: str) -> None:
    silent, from_s = befalls("off", 0.0), 1.0 if verb == "take-off" else 5.0
    flight = Flight(
        befalls("pilot", from_s + 1.0, from_s + 2.0),
        fault=lambda: silent if from_s < now_s() < from_s + 2.5 else None,
    )
    with pytest.raises(AutopilotOverruled, match=f"{verb}: "):  # the pilot lands it later
        await (await flight.take_off()).turn_to(180.0)


@played(fly)
async def test_a_fail_safe_does_not_take_a_vehicle_that_lands_already() -> None:
    flight = Flight(befalls("fail-safe", 8.0))
    autopilot = await flight.take_off()
    with pytest.raises(AutopilotOverruled, match="disarmed itself"):
        await autopilot.land()
    assert autopilot.stands and not flight.taken


@pytest.mark.parametrize(
    ("to_s", "taken"),
    [
        (12.5, ["restarted autopilot", "pilot"]),  # it catches itself, and a pilot lands it
        (13.5, ["restarted autopilot"]),  # it falls for 2 s
        (40.0, ["restarted autopilot"]),
    ],
)
@played(fly)
async def test_after_a_restart_in_flight_nothing_is_sent_and_no_person_is_named(
    *, to_s: float, taken: list[str]
) -> None:
    flight = Flight(befalls("restart", 12.0, to_s))
    autopilot = await flight.take_off()
    sent = len(flight.commands)
    with pytest.raises(AutopilotError):
        await autopilot.goto(THERE)
    with pytest.raises(AutopilotError):
        await autopilot.hold()
    assert len(flight.commands) == sent + 1, "the leg that it was on"
    await asyncio.sleep(max(0.0, to_s + 2.0 - asyncio.get_running_loop().time()))
    assert autopilot.control.owner is Owner.UNKNOWN and "restarted" in autopilot.control.why
    named = {each.owner for each in flight.news if hasattr(each, "owner")}
    assert named == {Owner.PROGRAM, Owner.UNKNOWN}
    await autopilot.stood()
    assert autopilot.stands and not autopilot.armed and flight.taken == taken


@played(fly)
async def test_a_vehicle_that_falls_after_a_restart_falls_on_after_a_second_one() -> None:
    flight = Flight(befalls("restart", 12.0, 13.2), befalls("restart", 13.3, 13.6))
    autopilot = await flight.take_off()
    with pytest.raises(AutopilotError):
        await autopilot.goto(THERE)
    await autopilot.stood()
    assert autopilot.stands and not autopilot.armed


@played(fly)
async def test_a_vehicle_that_restarts_before_it_lifts_off_stays_on_the_ground() -> None:
    flight = Flight(befalls("restart", 0.1, 4.0), manner=arducopter)
    with pytest.raises(AutopilotError):
        await flight.take_off()
    async with asyncio.timeout(60.0):
        await flight.autopilot.stood()
    await asyncio.sleep(30.0)
    assert flight.autopilot.stands and not flight.autopilot.armed


@played(fly)
async def test_an_autopilot_that_restarts_on_the_ground_is_waited_for() -> None:
    flight = Flight(befalls("restart", 0.0, 7.0))
    await asyncio.sleep(1.0)
    autopilot = await flight.take_off()
    assert asyncio.get_running_loop().time() == pytest.approx(12.0)
    await autopilot.goto(THERE)
    assert autopilot.control.is_ours and not flight.taken


@played(fly)
async def test_heartbeats_of_another_program_change_nothing() -> None:
    flight = Flight(befalls("impostor", 0.0, 60.0))
    autopilot = await flight.take_off()
    await autopilot.goto(THERE)
    await autopilot.return_home_and_land()
    await autopilot.disarm()
    assert autopilot.control.is_ours and not flight.taken


@played(fly)
async def test_a_second_battery_drains_in_flight_and_lets_the_vehicle_fall() -> None:
    flight = Flight(befalls("battery", 0.0, lasts_s=20.0))
    autopilot = await flight.take_off()
    before = autopilot.telemetry.batteries[2]
    await asyncio.sleep(5.0)
    after = autopilot.telemetry.batteries[2]
    assert before is not None and after is not None
    assert before - after == pytest.approx(25.0)
    await asyncio.sleep(20.0)
    assert (autopilot.control.owner, autopilot.telemetry.batteries[2]) == (Owner.FAILSAFE, 0.0)


def test_a_mission_tells_a_moved_home_once_and_ends_by_a_jump_in_the_action_that_is_configured() -> None:
    faults = [fault("autopilot", "home", from_s=10.0), fault("autopilot", "jump", from_s=30.0)]
    seen: list[Observation] = []
    (run,) = simulate_fleet([scenario(faults=faults, columns=3, rows=2)], seen=seen)
    moved = [event for event in run.events if isinstance(event, schema.HomeMoved)]
    (doubted,) = [event for event in run.events if isinstance(event, schema.PositionDoubted)]
    assert [(event.east_m, event.north_m) for event in moved] == [(40.0, 50.0)]
    assert doubted.jumped_m == pytest.approx(50.0) and "its reported position jumped 50 m" in run.failure
    assert not [event for event in run.events if isinstance(event, schema.PhotoTaken) and event.t > doubted.t]
    (safe_end,) = [event for event in run.events if isinstance(event, schema.SafeEnd)]
    assert safe_end.action == "return" and "jumped" in safe_end.why
    assert max(each.off_m for each in seen if each.event == "reached") < 1.0
