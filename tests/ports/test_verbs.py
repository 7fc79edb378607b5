"""What each verb sends to an ArduCopter, when it is done, and when it gives up."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.memory import AT_ONCE
from tests.ports.scripted import FRAME, IN_AIR, ON_GROUND, SYSTEM, Script, landed, scripted

from upwash.core.geo import Position, Velocity
from upwash.core.vehicle.control import Owner
from upwash.errors import AutopilotOverruled, AutopilotRefused, AutopilotTimeout, UsageError
from upwash.eventlog.schema import ArmingDelayed
from upwash.real.mavlink import MavlinkAutopilot
from upwash.sim.loop import run_virtually

HERE, GROUND = Position(30.0, 40.0, 10.0), Position(0.0, 0.0)
REPOSITION, SPEED, YAW = (
    mavlink.MAV_CMD_DO_REPOSITION,
    mavlink.MAV_CMD_DO_CHANGE_SPEED,
    mavlink.MAV_CMD_CONDITION_YAW,
)
ARM, SERVO, CHECKS, TAKEOFF = (
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_DO_SET_SERVO,
    mavlink.MAV_CMD_RUN_PREARM_CHECKS,
    mavlink.MAV_CMD_NAV_TAKEOFF,
)
DENIED, FAILED = mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_FAILED
Verb = Callable[[MavlinkAutopilot], Awaitable[None]]


def tell(story: Callable[[Script], Awaitable[None]], *, flies: bool = True) -> None:
    """Runs a story with a vehicle that flies 10 m high for the program, or stands for it."""

    async def live() -> None:
        async with scripted(armed=flies) as script:
            if flies:
                await script.resumed(HERE)
            else:
                await script.autopilot.claim(resumes=False)
            await story(script)

    run_virtually(live())


def parameters(message: Any) -> tuple[float, ...]:
    count = 4 if message.get_type() == "COMMAND_INT" else 7
    return tuple(getattr(message, f"param{number}") for number in range(1, count + 1))


@pytest.mark.parametrize(
    ("verb", "limit_s"),
    [
        (lambda autopilot: autopilot.goto(Position(30.0, 140.0, 14.0)), 60 + 100 * 3 / 5 + 4 / 0.4),
        (lambda autopilot: autopilot.goto(Position(30.0, 40.0, 6.0)), 60 + 4 / 0.4),
        (lambda autopilot: autopilot.takeoff(20.0), 60 + 20 / 0.4),
        (lambda autopilot: autopilot.land(), 60 + 10 / 0.4),
        (
            lambda autopilot: autopilot.return_home_and_land(),
            60 + 50 * 3 / 5 + 10 / 0.4 + 2 * (60 + 100 / 0.4),
        ),
        (lambda autopilot: autopilot.hold(), 60),
        (lambda autopilot: autopilot.turn_to(90.0), 80),
    ],
    ids=["leg", "descent", "take-off", "landing", "return", "hold", "turn"],
)
@played(tell)
async def test_a_verb_has_the_time_of_a_slow_flight(script: Script, *, verb: Verb, limit_s: float) -> None:
    await script.say(script.place(HERE, Velocity(east_m_s=3.0)))
    begun_s = script.now_s
    with pytest.raises(AutopilotTimeout, match=f"not done within {limit_s:.0f} s"):
        await verb(script.autopilot)
    assert script.now_s - begun_s == pytest.approx(limit_s, abs=0.01)


@pytest.mark.parametrize(("silent_s", "limit_s"), [(2.4, 60.0), (2.9, 63.3), (10.0, 70.0)])
@played(tell)
async def test_a_silence_in_a_verb_lengthens_it(script: Script, *, silent_s: float, limit_s: float) -> None:
    await script.say(script.place(HERE, Velocity(east_m_s=3.0)))
    begun_s = script.now_s
    hold = asyncio.ensure_future(script.autopilot.hold())
    await asyncio.sleep(57.2)
    await script.beat()
    script.mute = True
    await asyncio.sleep(silent_s)
    script.mute = False
    await script.beat()
    with pytest.raises(AutopilotTimeout):
        await hold
    assert script.now_s - begun_s == pytest.approx(limit_s, abs=0.05)  # looked at each half second


@played(tell)
async def test_silences_before_a_verb_do_not_lengthen_it(script: Script) -> None:
    for _ in range(2):
        script.mute = True
        await asyncio.sleep(8.0)
        script.mute = False
        await asyncio.sleep(2.0)
    await script.say(script.place(HERE, Velocity(east_m_s=3.0)))
    begun_s = script.now_s
    with pytest.raises(AutopilotTimeout):
        await script.autopilot.hold()
    assert script.now_s - begun_s == pytest.approx(60.0, abs=0.01)


@pytest.mark.parametrize(
    ("home", "altitude_m", "limit_s"),
    [(Position(30.0, 100.0), 10.0, 60 + 36 + 25 + 620), (Position(30.0, 40.0), 120.0, 60 + 300 + 2 * 360)],
)
@played(tell)
async def test_a_return_has_the_time_to_its_own_home(
    script: Script, *, home: Position, altitude_m: float, limit_s: float
) -> None:
    geo = FRAME.geo(home)
    place = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
    await script.say(
        mavlink.MAVLink_home_position_message(*place, 488_000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0),
        script.place(HERE.at_altitude(altitude_m)),
    )
    with pytest.raises(AutopilotTimeout, match=f"not done within {limit_s} s, in mode RTL"):
        await script.autopilot.return_home_and_land()


# --- take-off -----------------------------------------------------------------------------------------------


async def stands_armed(script: Script) -> None:
    """It stands on the ground with its motors running, for the program."""
    script.results[REPOSITION] = DENIED
    await script.say(landed(ON_GROUND), script.place(GROUND))
    await script.autopilot.arm()
    del script.results[REPOSITION]


@played(tell, flies=False)
async def test_a_take_off_ends_at_rest_at_its_altitude_in_the_air(script: Script) -> None:
    await stands_armed(script)
    rising = await begun(script, script.autopilot.takeoff(10.0))
    (order,) = script.commands(TAKEOFF)
    assert parameters(order) == (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 10.0)
    for altitude_m, up_m_s, state, done in (
        (9.0, 0.0, ON_GROUND, False),
        (8.9, 0.0, IN_AIR, False),
        (9.0, 0.5, IN_AIR, False),
        (9.0, 0.4, IN_AIR, True),
    ):
        await script.say(landed(state), script.place(GROUND.at_altitude(altitude_m), Velocity(up_m_s=up_m_s)))
        await asyncio.sleep(0.125)
        assert rising.done() is done
    await script.autopilot.set_ground_speed(3.0)
    assert script.commands(SPEED) == [], "it would lose a speed before its first target"
    moved = script.place(GROUND.at_altitude(9.0))
    moved.relative_alt -= 3000
    await script.say(moved)
    assert script.autopilot.position.altitude_m == pytest.approx(9.0), "it counts from the ground"
    await script.say(target(THERE))
    assert script.autopilot.control.owner is Owner.GROUND_STATION


@pytest.mark.parametrize(
    ("flew", "seen_after_s", "rises"), [(False, 0.9, True), (False, 1.1, False), (True, 0.0, False)]
)
@played(tell, flies=False)
async def test_a_take_off_whose_answer_was_lost_shows_within_a_second(
    script: Script, *, flew: bool, seen_after_s: float, rises: bool
) -> None:
    await stands_armed(script)
    if flew:
        await script.say(landed(IN_AIR))
    script.results[TAKEOFF] = FAILED
    rising = await begun(script, script.autopilot.takeoff(10.0))
    await asyncio.sleep(0.5 - 0.125 + seen_after_s)  # half a second for its words
    await script.say(landed(IN_AIR), script.place(GROUND.at_altitude(10.0)))
    if rises:
        await rising
    else:
        with pytest.raises(AutopilotRefused, match="MAV_RESULT_FAILED to MAV_CMD_NAV_TAKEOFF"):
            await rising


@played(tell)
async def test_a_speed_waits_for_the_first_target_of_each_flight(script: Script) -> None:
    await script.autopilot.set_ground_speed(5.0)
    assert script.commands(SPEED) == []
    leg = await begun(script, script.autopilot.goto(THERE))
    await script.say(script.place(Position(30.0, 41.0, 10.0), Velocity(north_m_s=1.0)))
    await asyncio.sleep(0.125)
    leg.cancel()
    await script.autopilot.set_ground_speed(3.0)
    assert [parameters(sent)[1] for sent in script.commands(SPEED)] == [5.0, 3.0]
    rising = await begun(script, script.autopilot.takeoff(10.0))
    await script.autopilot.set_ground_speed(4.0)
    assert len(script.commands(SPEED)) == 2
    rising.cancel()


# --- legs ---------------------------------------------------------------------------------------------------

THERE = Position(30.0, 140.0, 14.0)


async def begun(script: Script, verb: Awaitable[None]) -> asyncio.Future[None]:
    task = asyncio.ensure_future(verb)
    await asyncio.sleep(0.125)
    return task


@played(tell)
async def test_a_target_is_a_place_above_the_sea_and_repeated_without_progress(script: Script) -> None:
    begun_s = script.now_s
    leg = await begun(script, script.autopilot.goto(THERE))
    await asyncio.sleep(7.0)
    order, *again = script.commands(REPOSITION)
    assert len(again) == 2
    assert order.get_type() == "COMMAND_INT"
    assert (order.target_system, order.target_component) == (SYSTEM, 1)
    assert (order.frame, order.current, order.autocontinue) == (mavlink.MAV_FRAME_GLOBAL, 0, 0)
    *flags, heading = parameters(order)
    assert flags == [-1.0, 0.0, 0.0] and math.isnan(heading)
    geo = FRAME.geo(THERE)
    assert (order.x, order.y) == (round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7))
    assert order.z == pytest.approx(488.0 + 14.0)
    times_s = [at_s - begun_s for at_s, sent in script.sent if getattr(sent, "command", 0) == REPOSITION]
    assert times_s == pytest.approx([0.0, 3.0, 6.0], abs=0.01)
    assert script.commands(SPEED) == []
    leg.cancel()


@played(tell)
async def test_the_speed_is_sent_once_it_flies_and_again_while_it_flies_faster(script: Script) -> None:
    leg = await begun(script, script.autopilot.goto(THERE))
    begun_s, north_m = script.now_s, 40.0
    for fast_m_s, sent in (6.0, 1), (6.0, 1), (6.1, 2), (6.1, 3), (5.0, 3):
        for _ in range(10):
            await asyncio.sleep(0.5)
            north_m += 0.6
            await script.say(script.place(Position(30.0, north_m, 10.0), Velocity(north_m_s=fast_m_s)))
        assert abs(len(script.commands(SPEED)) - sent) <= (fast_m_s == 6.1)
    first = script.commands(SPEED)[0]
    assert parameters(first) == (mavlink.SPEED_TYPE_GROUNDSPEED, 5.0, -1.0, 0.0, 0.0, 0.0, 0.0)
    assert len(script.commands(REPOSITION, since_s=begun_s)) == 0
    times_s = [at_s for at_s, message in script.sent if getattr(message, "command", 0) == SPEED]
    assert all(later_s - earlier_s > 5.0 for earlier_s, later_s in itertools.pairwise(times_s))
    assert 2 <= len(times_s) <= 4
    await script.autopilot.set_ground_speed(2.0)
    assert parameters(script.commands(SPEED)[-1])[1] == 2.0
    leg.cancel()


@pytest.mark.parametrize(
    ("off_m", "speed_m_s", "arrives"),
    [(0.98, 0.49, True), (1.02, 0.0, False), (0.0, 0.5, False), (0.0, 0.0, True)],
)
@played(tell)
async def test_a_leg_ends_at_rest_within_a_metre(
    script: Script, *, off_m: float, speed_m_s: float, arrives: bool
) -> None:
    leg = await begun(script, script.autopilot.goto(THERE))
    for north_m in range(40, 140, 2):
        await asyncio.sleep(0.25)
        await script.say(script.place(Position(30.0, float(north_m), 14.0), Velocity(north_m_s=8.0)))
    await asyncio.sleep(0.25)
    at_end = Position(THERE.east_m, THERE.north_m - off_m, 14.0)
    await script.say(script.place(at_end, Velocity(north_m_s=speed_m_s)))
    await asyncio.sleep(0.25)
    assert leg.done() is arrives
    leg.cancel()


@pytest.mark.parametrize(("below_m", "arrives"), [(1.0, True), (1.001, False)])
@played(tell)
async def test_a_leg_ends_a_metre_away_to_the_millimetre(
    script: Script, *, below_m: float, arrives: bool
) -> None:
    leg = await begun(script, script.autopilot.goto(GROUND.at_altitude(10.0)))
    for left in range(24, -1, -1):
        await asyncio.sleep(0.25)
        place = Position(30.0 * left / 25, 40.0 * left / 25, 10.0 - below_m)
        await script.say(script.place(place, Velocity(-4.8, -6.4) if left else Velocity()))
    await asyncio.sleep(0.25)
    assert leg.done() is arrives
    leg.cancel()


@pytest.mark.parametrize("result", [DENIED, FAILED])
@played(tell)
async def test_a_target_that_is_refused_is_no_change_of_the_owner(script: Script, *, result: int) -> None:
    script.results[REPOSITION] = result
    fence = "as it does to a target outside its own fence"
    with pytest.raises(AutopilotRefused, match="answered MAV_RESULT_") as caught:
        await script.autopilot.goto(THERE)
    assert (fence in caught.value.problem) == (result == FAILED)
    script.results.clear()
    await script.autopilot.hold()
    assert script.autopilot.control.is_ours


def target(place: Position) -> Any:
    """The report that it steers to the place."""
    geo = FRAME.geo(place)
    lat, lon = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
    frame, ignored = mavlink.MAV_FRAME_GLOBAL, 0b1111_1111_1000
    return mavlink.MAVLink_position_target_global_int_message(
        0, frame, ignored, lat, lon, 488.0 + place.altitude_m, *[0.0] * 8
    )


@pytest.mark.parametrize(("refused", "ours"), [(False, True), (True, False)])
@played(tell)
async def test_a_target_that_was_refused_is_no_target_of_the_program(
    script: Script, *, refused: bool, ours: bool
) -> None:
    leg = await begun(script, script.autopilot.goto(HERE))
    await script.say(target(HERE))
    assert script.autopilot.control.is_ours
    leg.cancel()
    if refused:
        script.results[REPOSITION] = FAILED
    leg = await begun(script, script.autopilot.goto(THERE))
    await asyncio.sleep(1.0)
    await script.say(target(THERE))
    assert script.autopilot.control.is_ours is ours
    with suppress(AutopilotRefused, asyncio.CancelledError):
        leg.cancel()
        await leg


@pytest.mark.parametrize(
    ("verb", "command"),
    [
        (lambda autopilot: autopilot.goto(THERE), REPOSITION),
        (lambda autopilot: autopilot.takeoff(20.0), TAKEOFF),
    ],
)
@played(tell)
async def test_a_refusal_after_a_pilot_took_over_is_the_pilots_doing(
    script: Script, *, verb: Verb, command: int
) -> None:
    script.results[command] = FAILED
    trying = await begun(script, verb(script.autopilot))
    await script.beat(mode=mavlink.COPTER_MODE_LOITER)
    with pytest.raises(AutopilotOverruled, match="LOITER"):
        await trying


@pytest.mark.parametrize(
    ("verb", "obeys"),
    [
        (lambda autopilot: autopilot.takeoff(20.0), True),
        (lambda autopilot: autopilot.turn_to(90.0), True),
        (lambda autopilot: autopilot.land(), True),
        (lambda autopilot: autopilot.disarm(), False),
    ],
)
@played(tell)
async def test_a_pilot_who_takes_over_in_a_verb_ends_it(script: Script, *, verb: Verb, obeys: bool) -> None:
    script.obeys = obeys
    await script.say(script.place(HERE, heading_deg=180.0))
    flying = await begun(script, verb(script.autopilot))
    await script.beat(mode=mavlink.COPTER_MODE_LOITER)
    with pytest.raises(AutopilotOverruled, match="LOITER"):
        await asyncio.wait_for(flying, 1.0)


@pytest.mark.parametrize("avoids", [0.0, 1.0])
@played(tell)
async def test_a_vehicle_that_flies_round_obstacles_may_change_its_target(
    script: Script, *, avoids: float
) -> None:
    script.parameters["OA_TYPE"] = avoids
    await script.autopilot.limits()
    leg = await begun(script, script.autopilot.goto(HERE))
    await script.say(target(HERE), target(THERE))
    assert script.autopilot.control.is_ours is bool(avoids)
    leg.cancel()


@pytest.mark.parametrize(("nearer_m", "again"), [(0.48, True), (0.52, False)])
@played(tell)
async def test_half_a_metre_in_three_seconds_is_progress(
    script: Script, *, nearer_m: float, again: bool
) -> None:
    leg = await begun(script, script.autopilot.goto(THERE))
    await script.say(script.place(HERE))
    await asyncio.sleep(2.5)
    north_m = THERE.north_m - math.hypot(100.0, 4.0) + nearer_m
    await script.say(script.place(Position(30.0, north_m, 14.0)))
    await asyncio.sleep(0.5)
    assert len(script.commands(REPOSITION)) == 1 + again
    leg.cancel()


@pytest.mark.parametrize(
    ("wanted_deg", "now_deg", "done"),
    [(90.0, 85.0, True), (90.0, 84.9, False), (90.0, 95.0, True), (2.0, 357.0, True), (2.0, 356.9, False)],
)
@played(tell)
async def test_a_turn_ends_within_five_degrees(
    script: Script, *, wanted_deg: float, now_deg: float, done: bool
) -> None:
    await script.say(script.place(HERE, heading_deg=180.0))
    turn = await begun(script, script.autopilot.turn_to(wanted_deg))
    assert parameters(script.commands(YAW)[0]) == (wanted_deg, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert not turn.done()
    await script.say(script.place(HERE, heading_deg=now_deg))
    await asyncio.sleep(0.125)
    assert turn.done() is done
    turn.cancel()


@played(tell)
async def test_a_hold_aims_at_the_place_where_it_comes_to_rest(script: Script) -> None:
    await script.say(script.place(HERE, Velocity(north_m_s=4.0)))
    hold = await begun(script, script.autopilot.hold())
    (order,) = script.commands(REPOSITION)
    geo = FRAME.geo(Position(30.0, 40.0 + 4.0 * (0.1 + 4.0 / (2 * 1.83)), 10.0))
    assert (order.x, order.y) == pytest.approx((geo.latitude_deg * 1e7, geo.longitude_deg * 1e7), abs=2)
    hold.cancel()


@pytest.mark.parametrize(("flies", "state"), [(False, IN_AIR), (True, ON_GROUND)])
def test_a_vehicle_that_stands_does_not_turn(state: int, *, flies: bool) -> None:
    async def story(script: Script) -> None:
        await script.say(landed(state))
        with pytest.raises(AutopilotRefused, match="stands on the ground; nothing was sent"):
            await script.autopilot.turn_to(90.0)
        assert script.commands(YAW) == []

    tell(story, flies=flies)


# --- the end of a flight ------------------------------------------------------------------------------------


@played(tell)
async def test_a_landing_ends_at_a_touchdown_that_is_reported_after_its_begin(script: Script) -> None:
    await script.say(landed(ON_GROUND))
    await asyncio.sleep(0.125)
    landing = await begun(script, script.autopilot.land())
    assert not landing.done(), "that report is older"
    await script.say(landed(IN_AIR))
    await asyncio.sleep(0.125)
    assert not landing.done()
    await script.say(landed(ON_GROUND))
    await asyncio.sleep(0.125)
    assert landing.done()
    await script.beat(armed=False)
    assert script.autopilot.control.is_ours, "it disarms itself after touchdown"


@played(tell)
async def test_without_a_landed_state_a_landing_ends_when_the_motors_stop(script: Script) -> None:
    await script.say(landed(0))
    landing = await begun(script, script.autopilot.land())
    assert not landing.done()
    await script.beat(armed=False)
    await asyncio.sleep(0.125)
    assert landing.done()


@pytest.mark.parametrize("falls", [True, False])
@played(tell)
async def test_motors_that_stop_in_the_air_are_no_touchdown(script: Script, *, falls: bool) -> None:
    landing = await begun(script, script.autopilot.land())
    await asyncio.sleep(1.0)
    await script.beat(armed=False)
    await script.say(landed(ON_GROUND))
    await asyncio.sleep(0.5)
    assert not landing.done()
    await script.say(script.place(HERE, Velocity(up_m_s=-3.0 if falls else 0.0)))
    await asyncio.sleep(0.125)
    if falls:
        with pytest.raises(AutopilotRefused, match="its motors stopped in the air"):
            await landing
    else:
        await script.say(landed(ON_GROUND))
        await landing


# --- commands -----------------------------------------------------------------------------------------------


@played(tell)
async def test_a_command_without_an_answer_is_sent_eight_times(script: Script) -> None:
    script.results[SERVO], begun_s = None, script.now_s
    with pytest.raises(AutopilotTimeout, match="no answer to MAV_CMD_DO_SET_SERVO after 8 attempts"):
        await script.autopilot.command(SERVO, "servo", (9.0, 1500.0))
    assert [message.confirmation for message in script.commands(SERVO)] == list(range(8))
    assert script.now_s - begun_s == pytest.approx(8.0, abs=0.1)


@played(tell)
async def test_an_earlier_answer_does_not_count(script: Script) -> None:
    await script.autopilot.command(SERVO, "servo", (9.0, 1500.0))
    script.results[SERVO] = None
    with pytest.raises(AutopilotTimeout, match="no answer to MAV_CMD_DO_SET_SERVO"):
        await script.autopilot.command(SERVO, "servo", (9.0, 1000.0))


@played(tell)
async def test_a_mode_that_was_refused_is_no_mode_of_the_program(script: Script) -> None:
    script.results[mavlink.MAV_CMD_DO_SET_MODE] = FAILED
    with pytest.raises(AutopilotRefused, match="MAV_RESULT_FAILED to MAV_CMD_DO_SET_MODE"):
        await script.autopilot.land()
    assert script.autopilot.control.is_ours
    await script.beat(mode=mavlink.COPTER_MODE_LAND)
    assert not script.autopilot.control.is_ours


@pytest.mark.parametrize(("text_s", "said"), [(-1.0, ""), (0.25, "too far (warning)"), (0.75, "")])
@played(tell)
async def test_a_refusal_waits_half_a_second_for_the_vehicles_words(
    script: Script, *, text_s: float, said: str
) -> None:
    text = mavlink.MAVLink_statustext_message(4, b"too far")
    if text_s < 0:
        await script.say(text)
        await asyncio.sleep(-text_s)
    script.results[SERVO] = DENIED
    refused = asyncio.create_task(script.autopilot.command(SERVO, "servo", ()))
    if text_s > 0:
        await asyncio.sleep(text_s)
        await script.say(text)
    with pytest.raises(
        AutopilotRefused, match=r"servo: .*MAV_RESULT_DENIED to MAV_CMD_DO_SET_SERVO"
    ) as caught:
        await refused
    assert caught.value.vehicle_said == said


@played(tell)
async def test_a_command_whose_effect_does_not_show_is_repeated_and_given_up(script: Script) -> None:
    script.obeys, begun_s = False, script.now_s
    with pytest.raises(AutopilotTimeout, match="MAV_CMD_COMPONENT_ARM_DISARM was accepted and not done"):
        await script.autopilot.disarm()
    assert [parameters(message)[0] for message in script.commands(ARM)] == [0.0] * 8
    assert script.now_s - begun_s == pytest.approx(8 * 2.5, abs=0.2)


@pytest.mark.parametrize("speed_m_s", [0.0, -1.0, math.nan])
@played(tell)
async def test_a_ground_speed_is_above_0(script: Script, *, speed_m_s: float) -> None:
    with pytest.raises(UsageError, match="give a number above 0"):
        await script.autopilot.set_ground_speed(speed_m_s)
    await script.autopilot.set_ground_speed(0.5)


# --- arming -------------------------------------------------------------------------------------------------


def health(*, passes: bool, sure: bool) -> tuple[Any, Any]:
    checked = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    return (
        mavlink.MAVLink_sys_status_message(checked, checked, checked * passes, 0, 12_000, 0, 99, *[0] * 6),
        mavlink.MAVLink_ekf_status_report_message(mavlink.EKF_POS_HORIZ_ABS * sure, *[0.0] * 5),
    )


@played(tell, flies=False)
async def test_its_checks_are_asked_for_until_the_time_is_over(script: Script) -> None:
    await script.say(*health(passes=False, sure=False))
    begun_s = script.now_s
    waiting = await begun(script, script.autopilot.ready())
    assert script.news[-1] == ArmingDelayed(reasons=())
    await script.say(mavlink.MAVLink_statustext_message(2, b"PreArm: Fence breached"))
    await script.say(mavlink.MAVLink_statustext_message(2, b"PreArm: Fence breached"))
    await script.say(mavlink.MAVLink_statustext_message(2, b"Arm: Leaning"))
    await script.say(mavlink.MAVLink_statustext_message(2, b"Takeoff: no reason"))
    await asyncio.sleep(0.5)
    assert script.news[-1] == ArmingDelayed(reasons=("Fence breached", "Leaning"))
    with pytest.raises(AutopilotRefused, match=r"was not ready within 120 s; the vehicle") as caught:
        await waiting
    assert caught.value.vehicle_said == "Fence breached; Leaning"
    assert script.now_s - begun_s == pytest.approx(120.0, abs=0.01)
    times_s = [at_s - begun_s for at_s, sent in script.sent if getattr(sent, "command", 0) == CHECKS]
    assert times_s == pytest.approx([5.0 * number for number in range(24)], abs=0.01)


@pytest.mark.parametrize(
    ("verb", "armed"),
    [(lambda autopilot: autopilot.ready(), True), (lambda autopilot: autopilot.arm(), False)],
)
@played(tell, flies=False)
async def test_a_pilot_who_takes_over_ends_the_wait_for_its_checks(
    script: Script, *, verb: Verb, armed: bool
) -> None:
    await script.say(*health(passes=False, sure=True))
    script.results[ARM], script.results[REPOSITION] = FAILED, DENIED
    waiting = await begun(script, verb(script.autopilot))
    await script.beat(armed=armed, mode=mavlink.COPTER_MODE_LOITER)
    with pytest.raises(AutopilotOverruled):
        await asyncio.wait_for(waiting, 1.0)


@pytest.mark.virtual
async def test_a_short_time_for_its_checks_is_kept() -> None:
    async with scripted(replace(AT_ONCE, ready_timeout_s=12.0)) as script:
        await script.autopilot.claim(resumes=False)
        await script.say(*health(passes=False, sure=True))
        begun_s = script.now_s
        with pytest.raises(AutopilotRefused, match="was not ready within 12 s"):
            await script.autopilot.ready()
        assert script.now_s - begun_s == pytest.approx(12.0, abs=0.01)


@played(tell, flies=False)
async def test_its_checks_are_not_given_up_in_a_silence(script: Script) -> None:
    await script.say(*health(passes=False, sure=True))
    waiting = await begun(script, script.autopilot.ready())
    await asyncio.sleep(115.0)
    script.mute = True
    await asyncio.sleep(15.0)
    assert not waiting.done()
    script.mute = False
    with pytest.raises(AutopilotRefused, match="was not ready within 120 s"):
        await asyncio.wait_for(waiting, 10.0)


@pytest.mark.parametrize(("passes", "sure"), [(True, False), (False, True)])
@played(tell, flies=False)
async def test_it_is_ready_when_its_checks_pass_and_it_knows_its_place(
    script: Script, *, passes: bool, sure: bool
) -> None:
    await script.say(*health(passes=passes, sure=sure))
    waiting = await begun(script, script.autopilot.ready())
    own = ("it does not know its position yet",) if passes else ()
    assert script.news[-1] == ArmingDelayed(reasons=own)
    await asyncio.sleep(20.0)
    assert not waiting.done()
    await script.say(*health(passes=True, sure=True))
    await asyncio.sleep(0.125)
    assert waiting.done()
    assert not script.autopilot.armed


@played(tell, flies=False)
async def test_arming_is_tried_again_every_two_seconds_while_its_last_checks_fail(script: Script) -> None:
    script.mode, script.results[ARM], script.results[REPOSITION] = 0, FAILED, DENIED
    begun_s = script.now_s
    arming = await begun(script, script.autopilot.arm())
    await script.say(mavlink.MAVLink_statustext_message(2, b"Arm: Throttle too high"))
    with pytest.raises(AutopilotRefused, match="MAV_RESULT_FAILED to MAV_CMD_COMPONENT_ARM_DISARM"):
        await arming
    assert ArmingDelayed(reasons=("Throttle too high",)) in script.news
    assert 115.0 < script.now_s - begun_s < 122.0
    assert 45 <= len(script.commands(ARM)) <= 61
    assert script.mode == mavlink.COPTER_MODE_GUIDED


@played(tell, flies=False)
async def test_an_armed_vehicle_is_waited_for_until_it_knows_its_place(script: Script) -> None:
    script.results[REPOSITION] = DENIED
    beats = len(script.of_kind("HEARTBEAT"))
    arming = await begun(script, script.autopilot.arm())
    assert script.autopilot.armed and not arming.done()
    assert len(script.of_kind("HEARTBEAT")) > beats, "a dead man counts from here on"
    await script.say(script.place(Position(0.0, 0.0)))
    await arming
    with pytest.raises(AutopilotOverruled, match=r"disarmed|motors"):
        script.armed = False
        await script.beat()
        await script.autopilot.takeoff(5.0)
