"""What each verb sends to a PX4, when it is done, and when it gives up."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.scripted import FRAME, IN_AIR, ON_GROUND, SYSTEM, Px4Script, Script, landed, scripted

from upwash.core.geo import Position, Velocity, distance_m
from upwash.core.vehicle.control import Owner
from upwash.errors import AutopilotOverruled, AutopilotRefused
from upwash.eventlog.schema import ArmingDelayed
from upwash.mavlink import px4
from upwash.mavlink.px4 import Mode
from upwash.real.mavlink import MavlinkAutopilot
from upwash.sim.loop import run_virtually

HERE, GROUND = Position(30.0, 40.0, 10.0), Position(0.0, 0.0)
THERE = Position(30.0, 52.0, 10.0)
SETPOINT, HEARTBEAT = "SET_POSITION_TARGET_GLOBAL_INT", mavlink.MAVLINK_MSG_ID_HEARTBEAT
TAKEOFF, SET_MODE = mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_DO_SET_MODE
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
Verb = Callable[[MavlinkAutopilot], Awaitable[None]]


def tell(story: Callable[[Script], Awaitable[None]], *, flies: bool = True) -> None:
    """Runs a story with a PX4 that hovers 10 m high for the program, or stands for it."""

    async def live() -> None:
        async with scripted(armed=flies, kind=Px4Script) as script:
            if flies:
                await script.resumed(HERE)
                await script.say(script.place(HERE))
            else:
                await script.autopilot.claim(resumes=False)
                await script.say(landed(ON_GROUND), script.place(GROUND))
            await story(script)

    run_virtually(live())


async def begun(verb: Awaitable[None]) -> asyncio.Future[None]:
    task = asyncio.ensure_future(verb)
    await asyncio.sleep(0.0625)
    return task


def modes(script: Script, since_s: float = 0.0) -> list[tuple[float, ...]]:
    """What the driver sent to change the mode."""
    return [(sent.param1, sent.param2, sent.param3) for sent in script.commands(SET_MODE, since_s)]


async def follow(
    script: Script,
    verb: asyncio.Future[None],
    *,
    off_m: Callable[[float], float] = lambda _: 0.0,
    within_s: float = 30.0,
    errs_m_s: float = 0.0,
    beats: Callable[[int], int] = lambda _: 0,
) -> int:
    """It reports eight times a second that it is at the setpoint or off it, with its velocity or a wrong one.

    Returns the number of reports until the verb was done.
    """
    for number in range(round(within_s * 8)):
        await asyncio.sleep(0.125)
        if verb.done():
            return number
        setpoint = script.of_kind(SETPOINT)[-1]
        place = FRAME.geo(Position(0.0, off_m(script.now_s)))
        await script.say(
            mavlink.MAVLink_global_position_int_message(
                round(script.now_s * 1e3),
                setpoint.lat_int + round((place.latitude_deg - FRAME.geo(GROUND).latitude_deg) * 1e7),
                setpoint.lon_int,
                round(setpoint.alt * 1e3),
                round((setpoint.alt - 488.0) * 1e3),
                vx=round((setpoint.vx + errs_m_s) * 100),
                vy=round(setpoint.vy * 100),
                vz=round(setpoint.vz * 100),
                hdg=0,
            ),
            *[script.heartbeat()] * beats(number),
        )
    return -1


# --- take-off -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("altitude_m", "climb_m_s", "from_m"),
    [
        (10.0, 0.0, 8.0),
        (10.0, 2.0, 8.0 - 1.2 * 2.0),
        (2.0, 1.0, 0.8),  # of the lowest take-off, to 4 m
        (2.0, 3.0, 0.5),
    ],
)
@played(tell, flies=False)
async def test_a_take_off_is_taken_over_before_it_ends(
    script: Script, *, altitude_m: float, climb_m_s: float, from_m: float
) -> None:
    await script.autopilot.arm()
    assert script.commands(SET_MODE) == []
    await asyncio.sleep(0.125)
    rising = await begun(script.autopilot.takeoff(altitude_m))
    assert script.commands(TAKEOFF) == [], "home moves until the motors run"
    await script.say(script.place(GROUND))
    await asyncio.sleep(0.125)
    (order,) = script.commands(TAKEOFF)
    assert (order.param1, order.param2, order.param3) == (-1.0, 0.0, 0.0)
    assert order.param7 == pytest.approx(488.0 + max(altitude_m, 4.0))
    up = Velocity(up_m_s=climb_m_s)
    for altitude, state, taken in (
        (from_m + 1.0, ON_GROUND, False),
        (from_m - 0.01, IN_AIR, False),
        (from_m, IN_AIR, True),
    ):
        await asyncio.sleep(1.0)
        await script.say(landed(state), script.place(GROUND.at_altitude(altitude), up))
        await asyncio.sleep(0.125)
        assert bool(script.of_kind(SETPOINT)) is taken
    await follow(script, rising)
    last = script.of_kind(SETPOINT)[-1]
    assert last.alt == pytest.approx(488.0 + altitude_m)
    assert modes(script) == [(1.0, 6.0, 0.0)]
    assert rising.done()
    moved = script.place(GROUND.at_altitude(altitude_m))
    moved.relative_alt -= 3000
    await script.say(moved)
    assert script.autopilot.position.altitude_m == pytest.approx(altitude_m), "it counts from the ground"


@played(tell, flies=False)
async def test_nothing_is_sent_before_it_is_armed_or_while_it_stands(script: Script) -> None:
    since_s, autopilot = script.now_s, script.autopilot
    with pytest.raises(AutopilotRefused, match=r"takeoff to 5 m: the vehicle is not armed; nothing was sent"):
        await autopilot.takeoff(5.0)
    await autopilot.arm()
    for verb in (
        autopilot.goto(THERE),
        autopilot.turn_to(90.0),
        autopilot.hold(),
        autopilot.land(),
        autopilot.return_home_and_land(),
    ):
        with pytest.raises(AutopilotRefused, match="stands on the ground; nothing was sent"):
            await verb
    assert script.commands(SET_MODE, since_s) == script.of_kind(SETPOINT) == []


# --- legs ---------------------------------------------------------------------------------------------------


@played(tell)
async def test_setpoints_come_before_the_mode_and_lead_to_the_target(script: Script) -> None:
    begun_s = script.now_s
    leg = await begun(script.autopilot.goto(THERE))
    await follow(script, leg)
    assert leg.done()
    sent = [(at_s, message) for at_s, message in script.sent if message.get_type() == SETPOINT]
    assert sent[0][0] == begun_s
    (order_s,) = [at_s for at_s, message in script.sent if getattr(message, "command", 0) == SET_MODE]
    assert order_s == pytest.approx(begun_s + 0.6, abs=0.01)
    assert modes(script) == [(1.0, 6.0, 0.0)]
    gaps_s = [later_s - earlier_s for (earlier_s, _), (later_s, _) in itertools.pairwise(sent)]
    assert gaps_s == pytest.approx([0.05] * len(gaps_s), abs=0.001)
    last, place = sent[-1][1], FRAME.geo(THERE)
    assert (last.target_system, last.target_component) == (SYSTEM, 1)
    assert last.coordinate_frame == mavlink.MAV_FRAME_GLOBAL_INT
    assert (last.type_mask, last.yaw) == (
        2048,
        pytest.approx(0.0, abs=1e-3),
    )  # it flies north, nose first, at its own rate of turning
    assert (last.lat_int, last.lon_int) == (round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7))
    assert last.alt == pytest.approx(498.0)
    assert (last.vx, last.vy, last.vz, last.afx, last.afy, last.afz) == (0.0,) * 6
    fastest = max((message for _, message in sent), key=lambda message: message.vx)
    assert 3.0 < fastest.vx <= 5.0
    assert (fastest.vy, fastest.vz) == pytest.approx((0.0, 0.0), abs=0.01)


def drifting(speed_m_s: float) -> Callable[[float], float]:
    """From 0.9 m south of the setpoint to 0.9 m north of it, over and over, at that speed."""
    return lambda now_s: (speed_m_s * now_s) % 1.8 - 0.9


@pytest.mark.parametrize(
    ("off_m", "errs_m_s", "arrives", "stands"),
    [
        (lambda _: 0.97, 0.0, True, True),
        (lambda _: 1.03, 0.0, False, True),  # a hold may end anywhere
        (drifting(0.45), 0.0, True, True),
        (drifting(0.55), 0.0, False, False),
        (drifting(0.55), -0.55, False, False),
        (lambda _: 0.9, 0.6, True, True),  # as a real one after a turn, for four seconds
    ],
)
@played(tell)
async def test_a_leg_ends_within_a_metre_at_rest_over_a_second(
    script: Script, *, off_m: Callable[[float], float], errs_m_s: float, arrives: bool, stands: bool
) -> None:
    leg = await begun(script.autopilot.goto(THERE))
    await follow(script, leg, off_m=off_m, errs_m_s=errs_m_s)
    assert leg.done() is arrives
    leg.cancel()
    hold = await begun(script.autopilot.hold())
    await follow(script, hold, off_m=off_m, errs_m_s=errs_m_s)
    assert hold.done() is stands
    hold.cancel()


@pytest.mark.parametrize("mode", [Mode.LOITER, Mode.OFFBOARD])
@played(tell)
async def test_a_leg_that_ends_before_its_mode_is_there_does_not_hinder_the_next(
    script: Script, *, mode: Mode
) -> None:
    leg = await begun(script.autopilot.goto(HERE))
    await asyncio.sleep(0.25)
    await script.beat(mode=mode)  # setpoints alone may lead to their mode
    assert script.autopilot.control.is_ours
    leg.cancel()
    leg = await begun(script.autopilot.goto(THERE))
    await follow(script, leg)
    assert leg.done()
    assert modes(script) == ([(1.0, 6.0, 0.0)] if mode == Mode.LOITER else [])


@played(tell)
async def test_a_vehicle_is_at_rest_by_its_places_of_a_second(script: Script) -> None:
    leg = await begun(script.autopilot.goto(THERE))
    there_s = script.now_s + 100.5 / 8
    reports = await follow(
        script,
        leg,
        off_m=lambda now_s: 1.03 if now_s < there_s else 0.0,
        beats=lambda number: 50 * (number == 100),
    )
    assert reports == 109, "it came to its place a second ago"


@played(tell)
async def test_a_turn_is_held_until_the_next_leg(script: Script) -> None:
    turn = await begun(script.autopilot.turn_to(270.0))
    await asyncio.sleep(1.6)
    slowly = script.of_kind(SETPOINT)[-1]
    assert math.radians(-75.0) < slowly.yaw < math.radians(-20.0), "at 45 degrees a second"
    await asyncio.sleep(1.6)
    await script.say(script.place(HERE, heading_deg=264.9))
    await asyncio.sleep(0.125)
    assert not turn.done()
    await script.say(script.place(HERE, heading_deg=265.0))
    await asyncio.sleep(0.125)
    assert turn.done()
    held = script.of_kind(SETPOINT)[-1]
    assert (held.type_mask, held.yaw) == (2048, pytest.approx(math.radians(-90.0)))
    for place, nose_deg in (
        (Position(34.9, 40.0, 10.0), -90.0),
        (Position(35.1, 40.0, 10.0), 90.0),
        (THERE, 0.0),
    ):
        leg = await begun(script.autopilot.goto(place))
        for _ in range(40):
            await script.say(script.place(HERE))
            await asyncio.sleep(0.125)
        last = script.of_kind(SETPOINT)[-1]
        assert (last.type_mask, last.yaw) == (2048, pytest.approx(math.radians(nose_deg), abs=1e-3)), place
        leg.cancel()
    assert len(modes(script)) == 1, "it follows a course already"


# --- holds --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("holds", [True, False])
@played(tell)
async def test_a_vehicle_is_left_hovering_in_its_own_mode_after_a_hold_alone(
    script: Script, *, holds: bool
) -> None:
    leg = await begun(script.autopilot.goto(Position(30.0, 140.0, 10.0)))
    await follow(script, leg, within_s=6.0)
    leg.cancel()
    stop = script.autopilot.stopping_place
    flown_m = distance_m(HERE, script.autopilot.position)
    assert 1.0 < flown_m < distance_m(HERE, stop) - 5.0
    if holds:
        hold = await begun(script.autopilot.hold())
        await follow(script, hold)
        assert hold.done()
        assert distance_m(script.autopilot.position, stop) < 0.5
    since_s = script.now_s
    await script.autopilot.close()
    assert modes(script, since_s) == ([(1.0, 4.0, 3.0)] if holds else [])


# --- modes --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("verb", "mode", "number"),
    [
        (lambda autopilot: autopilot.goto(THERE), "OFFBOARD", (6.0, 0.0)),
        (lambda autopilot: autopilot.land(), r"AUTO\.LAND", (4.0, 6.0)),
        (lambda autopilot: autopilot.return_home_and_land(), r"AUTO\.RTL", (4.0, 5.0)),
    ],
)
@played(tell)
async def test_a_mode_that_the_vehicle_does_not_enter_is_commanded_eight_times(
    script: Script, *, verb: Verb, mode: str, number: tuple[float, float]
) -> None:
    script.obeys = False
    await script.say(mavlink.MAVLink_statustext_message(4, b"before"))
    trying = await begun(verb(script.autopilot))
    while not trying.done():
        await script.say(mavlink.MAVLink_statustext_message(4, b"not now"))
        await asyncio.sleep(0.5)
    refusal = rf"the vehicle does not enter {mode}, it is in AUTO\.LOITER"
    with pytest.raises(AutopilotRefused, match=refusal) as caught:
        await trying
    assert caught.value.vehicle_said == "not now (warning)"
    assert modes(script) == [(1.0, *number)] * 8
    times_s = [at_s for at_s, sent in script.sent if getattr(sent, "command", 0) == SET_MODE]
    gaps_s = [later_s - earlier_s for earlier_s, later_s in itertools.pairwise(times_s)]
    assert all(1.49 < gap_s < 2.01 for gap_s in gaps_s)
    assert min(gaps_s) == pytest.approx(1.5)
    asked_s = [at_s - times_s[0] for at_s in script.asked_for(HEARTBEAT) if 0 < at_s - times_s[0] < 1.4]
    assert asked_s == pytest.approx([0.5, 1.0], abs=0.01)
    since_s = script.now_s
    await script.beat()
    await asyncio.sleep(0.25)
    assert script.of_kind(SETPOINT, since_s) == []
    assert script.autopilot.control.is_ours
    await script.beat(mode=Mode[mode.rpartition(".")[2]])
    assert not script.autopilot.control.is_ours, "it is not the program's act any more"


@played(tell)
async def test_a_landing_ends_the_setpoints(script: Script) -> None:
    leg = await begun(script.autopilot.goto(THERE))
    await follow(script, leg)
    landing = await begun(script.autopilot.land())
    since_s = script.now_s
    await script.say(script.place(HERE))
    await asyncio.sleep(0.25)
    assert script.of_kind(SETPOINT, since_s) == []
    await script.say(landed(ON_GROUND))
    await asyncio.sleep(0.125)
    assert landing.done()


@pytest.mark.parametrize(("after_s", "sent"), [(0.125, 0), (0.75, 1)])
@played(tell)
async def test_a_pilot_who_takes_it_before_its_mode_changes_keeps_it(
    script: Script, *, after_s: float, sent: int
) -> None:
    script.obeys = False
    leg = await begun(script.autopilot.goto(THERE))
    await asyncio.sleep(after_s)
    await script.beat(mode=Mode.POSCTL)
    await asyncio.sleep(0.0625)
    assert leg.done()
    with pytest.raises(AutopilotOverruled):
        await leg
    assert len(modes(script)) == sent


@played(tell)
async def test_setpoints_end_in_a_silence_and_go_on_once_the_mode_is_known_again(script: Script) -> None:
    leg = await begun(script.autopilot.goto(Position(30.0, 140.0, 10.0)))
    await follow(script, leg, within_s=2.0)
    script.mute, heard_s = True, script.now_s
    await asyncio.sleep(3.0)
    last_s = max(at_s for at_s, message in script.sent if message.get_type() == SETPOINT)
    assert heard_s + 0.5 < last_s <= heard_s + 0.6
    since_s = script.now_s
    for _ in range(4):
        await script.say(script.place(HERE))
        await asyncio.sleep(0.25)
    assert script.of_kind(SETPOINT, since_s) == []
    assert len([at_s for at_s in script.asked_for(HEARTBEAT) if at_s > since_s]) > 4
    await script.beat()
    await asyncio.sleep(0.125)
    assert script.of_kind(SETPOINT, since_s)
    leg.cancel()


@played(tell)
async def test_a_vehicle_that_goes_back_to_offboard_by_itself_is_not_the_pilots(script: Script) -> None:
    leg = await begun(script.autopilot.goto(THERE))
    await follow(script, leg, within_s=2.0)
    for mode, set_mode, owner in (
        (Mode.RTL, Mode.OFFBOARD, Owner.FAILSAFE),
        (Mode.OFFBOARD, Mode.OFFBOARD, Owner.FAILSAFE),  # a setpoint came late, from a busy computer
        (Mode.RTL, Mode.OFFBOARD, Owner.FAILSAFE),
        (Mode.LOITER, Mode.LOITER, Owner.UNKNOWN),
    ):
        script.mode, script.intends = mode, set_mode  # type: ignore[attr-defined]
        await script.say(landed(IN_AIR), script.place(HERE), script.told()[px4.CURRENT_MODE])
        assert script.autopilot.control.owner is owner
    leg.cancel()


@pytest.mark.virtual
async def test_nothing_goes_on_after_the_driver_is_closed() -> None:
    before = asyncio.all_tasks()
    async with scripted(armed=True, kind=Px4Script) as script:
        await script.resumed(HERE)
        leg = await begun(script.autopilot.goto(THERE))
        await follow(script, leg, within_s=3.0)
        leg.cancel()
    await asyncio.sleep(0)
    assert asyncio.all_tasks() == before


# --- before the flight --------------------------------------------------------------------------------------


def event(name: str, *arguments: int, severity: int = 8) -> px4.EventMessage:
    number, kind = next((number, kind) for number, kind in px4.px4_events().items() if kind.name == name)
    return px4.EventMessage(
        id_of_event=number,
        event_time_boot_ms=0,
        sequence=0,
        destination_component=0,
        destination_system=0,
        log_levels=severity << 4 | severity,
        arguments=kind.packed(*arguments),
    )


def health(*, passes: bool) -> tuple[Any, Any]:
    checked = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    return (
        mavlink.MAVLink_sys_status_message(0, 0, checked * passes, 0, 12_000, 0, 99, *[0] * 6),
        mavlink.MAVLink_estimator_status_message(1, mavlink.ESTIMATOR_POS_HORIZ_ABS, *[0.0] * 8),
    )


LOITER, POSCTL = 1 << 4, 1 << 2


@pytest.mark.parametrize(
    ("severity", "concerns", "told"),
    [
        (2, LOITER, True),
        (3, LOITER, True),
        (4, LOITER, False),  # a warning
        (3, POSCTL, False),
        (3, POSCTL | LOITER, True),
    ],
)
@played(tell, flies=False)
async def test_failed_checks_that_keep_it_from_hovering_are_told(
    script: Script, *, severity: int, concerns: int, told: bool
) -> None:
    await script.say(
        *health(passes=False),
        event("commander_arming_check_summary", 0, 0, 0, 0, 0),
        event("check_gf_violation_max_alt", concerns, 20, severity=severity),
    )
    waiting = asyncio.ensure_future(script.autopilot.ready())
    await asyncio.sleep(8.0)
    reasons = [news.reasons for news in script.news if isinstance(news, ArmingDelayed)]
    assert reasons == [("geofence: too high above home",) if told else ()]
    waiting.cancel()


@pytest.mark.parametrize(
    ("mode", "passes", "armable", "ready"),
    [
        (Mode.LOITER, True, 0, True),
        (Mode.LOITER, False, LOITER, False),
        (Mode.POSCTL, True, POSCTL, False),
        (Mode.POSCTL, False, POSCTL | LOITER, True),
        (Mode.POSCTL, True, None, False),
    ],
)
@played(tell, flies=False)
async def test_it_is_ready_when_it_could_be_armed_to_hover(
    script: Script, *, mode: Mode, passes: bool, armable: int | None, ready: bool
) -> None:
    await script.beat(mode=mode)
    await script.say(*health(passes=passes))
    if armable is not None:
        await script.say(event("commander_arming_check_summary", 0, 0, 0, armable, 0))
    waiting = asyncio.ensure_future(script.autopilot.ready())
    await asyncio.sleep(8.0)
    assert waiting.done() is ready
    waiting.cancel()
    assert script.commands(ARM) == script.commands(SET_MODE) == []


@pytest.mark.parametrize(
    ("intends", "acts_after_s", "resumes", "owned_after_s"),
    [
        (0, None, True, 0.0),
        (Mode.OFFBOARD, None, True, 5.0),  # 4 s of hovering before it acts, and one more
        (Mode.OFFBOARD, 4.5, True, None),
        (0, None, False, None),
    ],
)
@pytest.mark.virtual
async def test_a_fail_safe_has_the_time_to_act_before_a_flight_is_resumed(
    *, intends: int, acts_after_s: float | None, resumes: bool, owned_after_s: float | None
) -> None:
    async with scripted(armed=True, kind=Px4Script) as script:
        script.parameters["COM_FAIL_ACT_T"] = 4.0
        script.intends = intends  # type: ignore[attr-defined]
        await script.say(landed(IN_AIR), script.place(HERE), script.told()[px4.CURRENT_MODE])
        claiming = asyncio.ensure_future(script.autopilot.claim(resumes=resumes))
        if acts_after_s is not None:
            await asyncio.sleep(acts_after_s)
            script.mode, script.intends = Mode.RTL, Mode.OFFBOARD  # type: ignore[attr-defined]
            await script.say(script.told()[px4.CURRENT_MODE])
            await script.beat()
        if owned_after_s is None:
            with pytest.raises(AutopilotOverruled):
                await claiming
            return
        for wait_s, owned in (owned_after_s - 0.1, False), (0.25, True):
            await asyncio.sleep(wait_s)
            assert script.autopilot.control.is_ours is owned or wait_s < 0
        await claiming
