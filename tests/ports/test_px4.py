"""What the driver does with a PX4 and with no other: against its stand-in, on virtual time."""

from __future__ import annotations

import asyncio
import csv
import math
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.memory import Bench, driven
from tests.ports.steps import claim_and_arm, take_off

from upwash.core.geo import GeoPosition, Position, distance_m
from upwash.core.vehicle.control import Control, Owner
from upwash.errors import AutopilotOverruled, AutopilotRefused
from upwash.eventlog.schema import ArmingDelayed, VehicleSaid, VehicleSetting
from upwash.mavlink import px4
from upwash.mavlink.px4 import Mode, understood
from upwash.ports import VehicleNews
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot
from upwash.real.mavlink.parameters import read_parameters, set_parameter
from upwash.real.mavlink.px4_firmware import PX4
from upwash.real.mavlink.telemetry import VehicleTelemetry
from upwash.sim.loop import run_virtually
from upwash.vehicle.body.copter import FaultKind
from upwash.vehicle.px4.inputs import Sticks
from upwash.vehicle.px4.settings import Px4Settings

HOME = GeoPosition(39.3666, 22.9507)
RETURNS = {"COM_OBL_RC_ACT": 3.0}
EVENTS = Path(__file__).with_name("data") / "px4_events.csv"
SET_MODE, TAKEOFF = mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_NAV_TAKEOFF
Flight = Callable[[Bench, MavlinkAutopilot], Awaitable[None]]


def fly(
    flight: Flight, *, before: Callable[[Bench], Awaitable[None]] | None = None, **settings: object
) -> None:
    async def flown() -> None:
        vehicle = Px4Settings(HOME, home_altitude_m=488.0, **{"parameters": RETURNS, **settings})  # type: ignore[arg-type]
        async with driven(vehicle, before=before) as (sky, autopilot):
            await flight(sky, autopilot)

    run_virtually(flown())


async def nothing_is_sent(sky: Bench, for_s: float = 20.0) -> None:
    since_s = sky.now_s
    await asyncio.sleep(for_s)
    assert sky.commands(since_s) == []
    assert sky.setpoints(since_s) == 0


@played(fly)
async def test_it_takes_off_above_the_sea_and_hovers_in_offboard_at_its_altitude(
    sky: Bench, autopilot: MavlinkAutopilot
) -> None:
    await take_off(autopilot, 10.0)
    order = next(each for each in sky.heard if getattr(each, "command", None) == TAKEOFF)
    assert order.param7 == pytest.approx(498.0, abs=0.5)
    assert all(map(math.isnan, (order.param4, order.param5, order.param6)))  # as it stands
    assert sky.copter.mode is Mode.OFFBOARD
    assert autopilot.position.altitude_m == pytest.approx(10.0, abs=1.0)


@played(fly)
async def test_a_mode_is_believed_not_the_first_of_two_answers(
    sky: Bench, autopilot: MavlinkAutopilot
) -> None:
    await take_off(autopilot)
    sky.copter.fail(FaultKind.GPS, sky.now_s)  # OFFBOARD and RTL are accepted, then refused
    await asyncio.sleep(0.2)
    with pytest.raises(AutopilotRefused):
        await autopilot.return_home_and_land()


@played(fly)
async def test_legs_keep_their_speed(sky: Bench, autopilot: MavlinkAutopilot) -> None:
    await take_off(autopilot)
    for speed_m_s, target in (4.0, Position(60.0, 0.0, 5.0)), (2.0, Position(60.0, 30.0, 5.0)):
        await autopilot.set_ground_speed(speed_m_s)
        fastest_m_s, farthest_m = 0.0, 0.0
        leg = asyncio.create_task(autopilot.goto(target))
        begun = autopilot.position
        while not leg.done():
            await asyncio.sleep(0.1)
            velocity = autopilot.telemetry.velocity
            assert velocity is not None
            fastest_m_s = max(fastest_m_s, velocity.speed_m_s)
            farthest_m = max(farthest_m, distance_m(autopilot.position, begun))
        assert speed_m_s * 0.9 < fastest_m_s < speed_m_s * 1.25
        assert farthest_m < distance_m(begun, target) + 2.5


@pytest.mark.parametrize("moment", ["leg", "call", "return"])
@played(fly)
async def test_a_pilot_who_takes_it_keeps_it(sky: Bench, autopilot: MavlinkAutopilot, *, moment: str) -> None:
    news: list[VehicleNews] = []
    autopilot.listen(news.append)
    await take_off(autopilot)
    verb = (
        autopilot.return_home_and_land() if moment == "return" else autopilot.goto(Position(60.0, 0.0, 5.0))
    )
    flying = asyncio.create_task(verb)
    await asyncio.sleep(60.0 if moment == "call" else 3.0)
    mode = Mode.LOITER if moment == "call" else Mode.POSCTL
    sky.copter.move_sticks(sky.now_s, Sticks())
    sky.copter.set_mode(mode)
    if moment == "call":
        await flying
    else:
        with pytest.raises(AutopilotOverruled, match="the program has lost the vehicle"):
            await flying
    await asyncio.sleep(0.2)
    await nothing_is_sent(sky)
    for verb in (
        autopilot.hold(),
        autopilot.goto(Position(0.0, 0.0, 5.0)),
        autopilot.return_home_and_land(),
    ):
        with pytest.raises(AutopilotOverruled, match="the program has lost the vehicle"):
            await verb
    assert autopilot.control.owner is Owner.UNKNOWN
    assert [each.owner for each in news if isinstance(each, Control)] == [Owner.PROGRAM, Owner.UNKNOWN]


@played(fly)
async def test_no_command_follows_a_change_of_mode_that_the_driver_has_not_heard_of_yet(
    sky: Bench, autopilot: MavlinkAutopilot
) -> None:
    await take_off(autopilot)
    sky.copter.set_mode(Mode.LOITER)
    since_s = sky.now_s
    with pytest.raises(AutopilotOverruled):
        await autopilot.return_home_and_land()
    assert SET_MODE not in sky.commands(since_s)


@played(fly)
async def test_a_pilot_who_has_it_hover_in_the_climb_keeps_it(
    sky: Bench, autopilot: MavlinkAutopilot
) -> None:
    await claim_and_arm(autopilot)
    climbing = asyncio.create_task(autopilot.takeoff(20.0))
    await asyncio.sleep(8.0)
    assert 2.0 < autopilot.position.altitude_m < 16.0
    sky.copter.set_mode(Mode.LOITER)
    with pytest.raises(AutopilotOverruled, match="the program has lost the vehicle"):
        await climbing
    await nothing_is_sent(sky)


@played(fly, armable_after_s=60.0)
async def test_a_pilot_who_arms_it_during_the_wait_keeps_it(sky: Bench, autopilot: MavlinkAutopilot) -> None:
    await autopilot.claim(resumes=False)
    waiting = asyncio.create_task(autopilot.ready())
    await asyncio.sleep(20.0)
    assert not waiting.done()
    sky.copter.move_sticks(sky.now_s, Sticks())
    sky.copter.set_mode(Mode.STABILIZED)
    sky.copter.arm(sky.now_s, forced=True)
    with pytest.raises(AutopilotOverruled, match="somebody else armed it"):
        await waiting
    await nothing_is_sent(sky)


@played(fly, armable_after_s=30.0)
async def test_it_tells_within_a_second_why_it_cannot_be_armed_and_waits_without_a_command(
    sky: Bench, autopilot: MavlinkAutopilot
) -> None:
    told: list[tuple[float, ArmingDelayed]] = []

    def hear(news: VehicleNews) -> None:
        if isinstance(news, ArmingDelayed):
            told.append((sky.now_s, news))

    await autopilot.claim(resumes=False)
    autopilot.listen(hear)
    begun_s = sky.now_s
    await autopilot.ready()
    assert sky.commands() == []
    assert told[0][0] == begun_s
    assert told[-1][0] < begun_s + 1.0
    assert "no valid position estimate" in told[-1][1].reasons
    await autopilot.arm()


@played(fly)
async def test_a_low_battery_s_fail_safe_keeps_it(sky: Bench, autopilot: MavlinkAutopilot) -> None:
    news: list[VehicleNews] = []
    autopilot.listen(news.append)
    await take_off(autopilot)
    sky.copter.fail(FaultKind.BATTERY, sky.now_s)
    await asyncio.sleep(2.0)
    assert autopilot.control.owner is Owner.FAILSAFE
    assert "OFFBOARD was set" in autopilot.control.why
    await nothing_is_sent(sky)
    assert any("battery" in each.text for each in news if isinstance(each, VehicleSaid))


@played(fly)
async def test_after_a_silence_no_setpoint_takes_it_back_from_its_fail_safe(
    sky: Bench, autopilot: MavlinkAutopilot
) -> None:
    await take_off(autopilot)
    flying = asyncio.create_task(autopilot.goto(Position(200.0, 0.0, 5.0)))
    await asyncio.sleep(3.0)
    sky.cut = True
    await asyncio.sleep(5.0)
    assert sky.copter.mode is Mode.RTL
    sky.cut = False
    since_s = sky.now_s
    with pytest.raises(AutopilotOverruled, match="a fail-safe has the vehicle"):
        await flying
    assert sky.setpoints(since_s) == 0
    await nothing_is_sent(sky, for_s=5.0)
    assert sky.copter.mode is Mode.RTL


@played(fly, parameters={**RETURNS, "COM_OF_LOSS_T": 10.0})
async def test_a_silence_that_the_vehicle_bears_delays_the_leg_and_no_more(
    sky: Bench, autopilot: MavlinkAutopilot
) -> None:
    await take_off(autopilot)
    flying = asyncio.create_task(autopilot.goto(Position(60.0, 0.0, 5.0)))
    await asyncio.sleep(3.0)
    sky.cut = True
    await asyncio.sleep(5.0)
    sky.cut = False
    await flying
    assert distance_m(autopilot.position, Position(60.0, 0.0, 5.0)) <= 1.5


@pytest.mark.parametrize("after_s", [5.0, 20.0])
def test_a_flight_is_resumed_where_the_vehicle_hovers_and_nowhere_else(after_s: float) -> None:
    async def abandoned(sky: Bench) -> None:
        await asyncio.sleep(10.0)
        sky.copter.arm(sky.now_s, forced=True)
        sky.copter.take_off(10.0)
        await asyncio.sleep(after_s)

    async def resume(_: Bench, autopilot: MavlinkAutopilot) -> None:
        if after_s < 10.0:
            with pytest.raises(AutopilotOverruled, match=r"switch it to AUTO\.LOITER and resume"):
                await autopilot.claim(resumes=True)
            return
        await autopilot.claim(resumes=True)
        await autopilot.goto(Position(20.0, 0.0, 10.0))
        await autopilot.return_home_and_land()

    fly(resume, before=abandoned)


def test_a_flight_is_resumed_out_of_the_hover_that_the_loss_of_setpoints_ends_in() -> None:
    async def killed(sky: Bench) -> None:
        async with sky.program(FlightSettings(), ground_speed_m_s=5.0) as autopilot:
            await take_off(autopilot, 10.0)
        await asyncio.sleep(3.0)
        assert sky.copter.mode is Mode.LOITER

    async def resume(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        await autopilot.claim(resumes=True)
        await autopilot.goto(Position(20.0, 0.0, 10.0))
        assert sky.copter.mode is Mode.OFFBOARD

    fly(resume, before=killed, parameters={"COM_OBL_RC_ACT": 5.0})


@played(fly)
async def test_a_hold_ends_at_rest_and_is_left_hovering_when_the_program_ends(
    sky: Bench, autopilot: MavlinkAutopilot
) -> None:
    await take_off(autopilot)
    leg = asyncio.create_task(autopilot.goto(Position(200.0, 0.0, 5.0)))
    await asyncio.sleep(8.0)
    leg.cancel()
    await autopilot.hold()
    held = autopilot.position
    await autopilot.close()
    await asyncio.sleep(10.0)
    assert sky.copter.mode is Mode.LOITER
    assert distance_m(sky.copter.position(sky.now_s), held) < 2.0


@pytest.mark.parametrize("action", [6.0, 7.0])
def test_it_is_not_flown_where_it_falls_without_the_program(action: float) -> None:
    async def flight(_: Bench, autopilot: MavlinkAutopilot) -> None:
        await autopilot.claim(resumes=False)
        with pytest.raises(AutopilotRefused, match="COM_OBL_RC_ACT"):
            await autopilot.ready()

    fly(flight, parameters={"COM_OBL_RC_ACT": action})


@played(fly, parameters={"COM_OF_LOSS_T": 30.0})
async def test_it_tells_of_settings_that_a_user_should_know(_: Bench, autopilot: MavlinkAutopilot) -> None:
    news: list[VehicleNews] = []
    autopilot.listen(news.append)
    await autopilot.claim(resumes=False)
    await autopilot.ready()
    told = {each.name: each.value for each in news if isinstance(each, VehicleSetting)}
    assert told == {"COM_OBL_RC_ACT": 0.0, "COM_OF_LOSS_T": 30.0, "COM_RC_OVERRIDE": 1.0}


@played(fly, parameters={"GF_MAX_HOR_DIST": 50.0, "GF_MAX_VER_DIST": 40.0})
async def test_its_fence_is_among_its_limits(_: Bench, autopilot: MavlinkAutopilot) -> None:
    limits = await autopilot.limits()
    assert [fence.name for fence in limits.fences] == ["the vehicle's fence of 50 m around its home"]
    assert limits.highest_m == 40.0


@pytest.mark.parametrize(("low", "critical"), [(0.25, 0.125), (0.0, 0.125), (0.25, 0.0)])
def test_its_battery_s_stages_are_in_percent_and_0_stands_for_none(low: float, critical: float) -> None:
    async def flight(_: Bench, autopilot: MavlinkAutopilot) -> None:
        await autopilot.limits()
        energy = autopilot.energy
        assert (energy.low_percent, energy.critical_percent) == (100 * low or None, 100 * critical or None)

    fly(flight, parameters={**RETURNS, "BAT_LOW_THR": low, "BAT_CRIT_THR": critical})


@played(fly)
async def test_whole_parameters_travel_as_bytes(sky: Bench, autopilot: MavlinkAutopilot) -> None:
    vehicle = autopilot.vehicle
    assert await read_parameters(vehicle, ["COM_OBL_RC_ACT"]) == {"COM_OBL_RC_ACT": 3.0}
    await set_parameter(vehicle, "COM_OBL_RC_ACT", 5)
    assert sky.copter.parameters["COM_OBL_RC_ACT"] == 5


def test_recorded_events_are_told_in_words_once_and_only_where_they_matter() -> None:
    telemetry = VehicleTelemetry(armed=True, mode=Mode.LOITER)
    for row in csv.DictReader(EVENTS.read_text().splitlines()):
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        (message,) = map(understood, parser.parse_buffer(bytes.fromhex(row["frame"])))
        PX4.take(telemetry, message, float(row["time_s"]))
    assert [(text.severity, text.text) for _, text in telemetry.texts] == [
        (4, "no manual control input"),
        (4, "low battery"),
        (6, "no connection to the ground station"),
        (4, "low battery level, return advised"),
        (2, "critical battery"),
        (2, "critical battery level: switching to RTL in 5 seconds"),
        (0, "commander low bat shutdown failed (event 22624381)"),
        (2, "emergency battery level"),
        (2, "emergency battery level: switching to Land"),
    ]


def lost_in_a_leg(what_happens: Callable[[Bench], None], control: list[Control]) -> list[str]:
    """What the vehicle says once that happens to it on the way."""
    said: list[str] = []

    async def flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        news: list[VehicleNews] = []
        await take_off(autopilot)
        leg = asyncio.create_task(autopilot.goto(Position(200.0, 0.0, 5.0)))
        await asyncio.sleep(5.0)
        autopilot.listen(news.append)
        news.clear()
        what_happens(sky)
        with pytest.raises((AutopilotOverruled, AutopilotRefused)):
            await leg
        await asyncio.sleep(5.0)
        said.extend(each.text for each in news if isinstance(each, VehicleSaid))
        control.append(autopilot.control)

    fly(flight)
    return said


def test_a_lost_position_is_told_as_that_and_not_as_lost_setpoints() -> None:
    control: list[Control] = []
    said = lost_in_a_leg(lambda sky: sky.copter.fail(FaultKind.GPS, sky.now_s), control)
    assert "no offboard signal" not in said
    assert "no valid position estimate" in said
    assert control[0].owner is Owner.FAILSAFE


def checks(telemetry: VehicleTelemetry, *names: tuple[str, int], ends: bool = True) -> None:
    """A set of failed checks, each with the modes that it concerns."""
    numbers = {kind.name: number for number, kind in px4.px4_events().items()}

    def take(name: str, *arguments: int) -> None:
        kind = px4.px4_events()[numbers[name]]
        PX4.take(
            telemetry,
            px4.EventMessage(
                id_of_event=numbers[name],
                event_time_boot_ms=0,
                sequence=0,
                destination_component=0,
                destination_system=0,
                log_levels=kind.log_levels,
                arguments=kind.packed(*arguments),
            ),
            0.0,
        )

    take("commander_arming_check_summary", 0, 0, 0, 0, 0)
    for name, modes in names:
        take(name, modes, 20)
    if ends:
        take("commander_health_summary", 0, 0, 0, 0)


OFFBOARD_LOST, POSITION_LOST = ("check_modes_offboard_signal", 1 << 14), ("check_modes_local_pos", 1 << 4)


@pytest.mark.parametrize(
    ("sets", "said"),
    [
        ([[OFFBOARD_LOST]], ["no offboard signal"]),
        ([[OFFBOARD_LOST, POSITION_LOST]], ["no valid position estimate"]),
        ([[POSITION_LOST, OFFBOARD_LOST]], ["no valid position estimate"]),
        ([[POSITION_LOST], [POSITION_LOST, OFFBOARD_LOST]], ["no valid position estimate"]),
        ([[POSITION_LOST]], []),  # which OFFBOARD does not need by itself
        ([[OFFBOARD_LOST], [OFFBOARD_LOST]], ["no offboard signal"]),
        ([[OFFBOARD_LOST], [], [OFFBOARD_LOST]], ["no offboard signal"] * 2),
    ],
)
@pytest.mark.parametrize("ends", [True, False], ids=["whole", "without their ends"])
def test_of_failed_checks_the_one_that_says_why_is_told(
    sets: list[list[tuple[str, int]]], said: list[str], *, ends: bool
) -> None:
    telemetry = VehicleTelemetry(armed=True, mode=Mode.OFFBOARD)
    for each in sets:
        checks(telemetry, *each, ends=ends)
    checks(telemetry, *sets[-1])
    assert [text.text for _, text in telemetry.texts] == said


STATES = {
    Mode.MANUAL: 0,
    Mode.ALTCTL: 1,
    Mode.POSCTL: 2,
    Mode.MISSION: 3,
    Mode.LOITER: 4,
    Mode.RTL: 5,
    Mode.ACRO: 10,
    Mode.OFFBOARD: 14,
    Mode.STABILIZED: 15,
    Mode.TAKEOFF: 17,
    Mode.LAND: 18,
}


@pytest.mark.parametrize(("mode", "state"), STATES.items())
def test_a_failed_check_is_told_in_the_modes_that_it_concerns(mode: Mode, state: int) -> None:
    all_modes = 2**32 - 1
    for modes, said in (1 << state, ["no valid position estimate"]), (all_modes - (1 << state), []):
        telemetry = VehicleTelemetry(armed=True, mode=mode)
        checks(telemetry, ("check_modes_local_pos", modes))
        assert [text.text for _, text in telemetry.texts] == said
    telemetry = VehicleTelemetry(armed=False, mode=mode)
    checks(telemetry, ("check_modes_local_pos", all_modes))
    assert not telemetry.texts


def test_in_a_mode_that_is_not_known_each_failed_check_is_told() -> None:
    telemetry = VehicleTelemetry(armed=True, mode=123)
    checks(telemetry, ("check_modes_local_pos", 0))
    assert [text.text for _, text in telemetry.texts] == ["no valid position estimate"]


def test_modes_have_the_names_that_a_ground_station_shows() -> None:
    own = ("TAKEOFF", "LOITER", "MISSION", "RTL", "LAND")
    for mode in Mode:
        name = f"AUTO.{mode.name}" if mode.name in own else mode.name
        assert PX4.mode_name(mode) == name


def test_a_failsafe_has_its_cause_where_something_says_it() -> None:
    telemetry = VehicleTelemetry(
        armed=True, mode=Mode.LAND, flown_and_intended_mode=(Mode.LAND, Mode.OFFBOARD)
    )
    assert PX4.failsafe(telemetry, "AUTO.LAND") == "a fail-safe chose it, OFFBOARD was set"
    telemetry.knows_its_place = False
    assert PX4.failsafe(telemetry, "AUTO.LAND") == (
        "a fail-safe chose it (it does not know its position), OFFBOARD was set"
    )
    checks(telemetry, POSITION_LOST)
    assert PX4.failsafe(telemetry, "AUTO.LAND") == (
        "a fail-safe chose it (no valid position estimate), OFFBOARD was set"
    )
