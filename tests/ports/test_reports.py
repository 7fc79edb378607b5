"""What the driver makes of a vehicle's reports, one by one: who has it, whether it stands, where it is."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.scripted import (
    FRAME,
    HOME_ABOVE_SEA_M,
    IN_AIR,
    ON_GROUND,
    SYSTEM,
    Px4Script,
    Script,
    landed,
    scripted,
)

from upwash.core.geo import Position, Velocity
from upwash.core.vehicle.control import Owner
from upwash.errors import AutopilotLost, AutopilotOverruled, AutopilotRefused, AutopilotTimeout
from upwash.eventlog.schema import (
    ArmingDelayed,
    HomeMoved,
    LinkLost,
    LinkRestored,
    LinkTrouble,
    PositionDoubted,
    VehicleSaid,
)
from upwash.mavlink.px4 import CURRENT_MODE
from upwash.ports import ComingDown
from upwash.sim.loop import run_virtually

HERE = Position(30.0, 40.0, 10.0)
TIME, HEARTBEAT = mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, mavlink.MAVLINK_MSG_ID_HEARTBEAT


def tell(story: Callable[[Script], Awaitable[None]], *, armed: bool = False, flies: bool = False) -> None:
    """Runs a story with a vehicle that is armed, or flies in the program's mode for the program."""

    async def live() -> None:
        async with scripted(armed=armed or flies) as script:
            if flies:
                await script.resumed(HERE)
            await story(script)

    run_virtually(live())


# --- the link -----------------------------------------------------------------------------------------------


@played(tell)
async def test_the_driver_is_a_companion_computer_of_the_vehicles_system(script: Script) -> None:
    begun_s = script.now_s
    await asyncio.sleep(10.0)
    beats = script.of_kind("HEARTBEAT", since_s=begun_s)
    assert 9 <= len(beats) <= 11
    beat = beats[-1]
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (SYSTEM, 191)
    assert (beat.type, beat.autopilot, beat.base_mode, beat.custom_mode, beat.system_status) == (
        18,
        8,
        0,
        0,
        4,
    )
    assert beat.mavlink_version == 3


@pytest.mark.parametrize(
    ("kind", "own_hz"),
    [
        (
            Script,
            {
                "HEARTBEAT": 10.0,
                "POSITION_TARGET_LOCAL_NED": 5.0,
                "SYS_STATUS": 1.0,
                "EKF_STATUS_REPORT": 2.0,
                "FENCE_STATUS": 2.0,
                "WIND": 1.0,
            },
        ),
        (Px4Script, {"CURRENT_MODE": 50.0, "SYS_STATUS": 2.0, "ESTIMATOR_STATUS": 2.0}),
    ],
)
@pytest.mark.virtual
async def test_each_report_is_asked_for_as_often_as_the_driver_needs_it(
    kind: type[Script], own_hz: dict[str, float]
) -> None:
    async with scripted(kind=kind) as script:
        asked = script.commands(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)
        assert {message.confirmation for message in asked} == {0}, "each is asked for the first time"
        names = {CURRENT_MODE: "CURRENT_MODE"} | {
            number: known.msgname for number, known in mavlink.mavlink_map.items()
        }
        rates_hz = {names[int(message.param1)]: round(1e6 / message.param2, 3) for message in asked}
        assert rates_hz == own_hz | {
            "GLOBAL_POSITION_INT": 10.0,
            "EXTENDED_SYS_STATE": 4.0,
            "POSITION_TARGET_GLOBAL_INT": 5.0,
            "ATTITUDE": 4.0,
            "RC_CHANNELS": 5.0,
            "GPS_RAW_INT": 1.0,
            "SYSTEM_TIME": 1.0,
            "BATTERY_STATUS": 1.0,
        }


@played(tell)
async def test_a_silence_is_told_with_its_length(script: Script) -> None:
    script.mute = True
    await script.say(script.heartbeat())
    await asyncio.sleep(4.26)
    await script.say(script.heartbeat())
    await asyncio.sleep(0.1)
    assert script.news == [LinkLost(silent_s=2.5), LinkRestored(silent_s=4.3)]


@played(tell)
async def test_after_a_silence_the_mode_and_all_reports_are_asked_for(script: Script) -> None:
    script.mute = True
    await asyncio.sleep(5.25)
    script.sent.clear()
    await script.say(script.heartbeat())
    assert script.asked_for(mavlink.MAVLINK_MSG_ID_HEARTBEAT) == [script.now_s]
    assert len(script.commands(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)) == 4
    script.sent.clear()
    await script.say(script.heartbeat())
    assert script.sent == []


@played(tell, flies=True)
async def test_a_wait_ends_after_two_minutes_of_silence(script: Script) -> None:
    await script.beat()
    script.mute, begun_s = True, script.now_s
    with pytest.raises(AutopilotLost, match="nothing was heard on memory for 120 s"):
        await script.autopilot.border_crossed([])
    assert script.now_s - begun_s == pytest.approx(120.0, abs=0.01)


@played(tell, flies=True)
async def test_a_wait_beside_others_says_that_others_came(script: Script) -> None:
    await script.beat()
    script.mute = True
    other = bytes(script.heartbeat().pack(mavlink.MAVLink(None, 255, 190)))
    for second in range(1, 125):
        asyncio.get_running_loop().call_later(second, script._line.datagram_received, other, ("", 1))
    with pytest.raises(AutopilotLost, match="others, and not the vehicle, were heard on memory for 120 s"):
        await script.autopilot.border_crossed([])


@played(tell)
async def test_the_vehicles_time_goes_on_between_its_reports(script: Script) -> None:
    await script.say(mavlink.MAVLink_system_time_message(1_770_000_000_500_000, 1), script.place(HERE))
    await asyncio.sleep(10.0)
    told = script.autopilot.earth_position
    assert told is not None
    assert told.unix_s == pytest.approx(1_770_000_010.5, abs=1e-3)
    geo = FRAME.geo(HERE)
    assert (told.latitude_deg, told.longitude_deg) == pytest.approx((geo.latitude_deg, geo.longitude_deg))
    assert told.above_sea_m == HOME_ABOVE_SEA_M + 10.0


@played(tell)
async def test_numbers_that_do_not_count_are_told_after_the_second_judgement(script: Script) -> None:
    for judgement in range(1, 3):
        for boot_ms in range(40):
            script._codec.seq = 0
            await script.say(mavlink.MAVLink_attitude_message(boot_ms + 100 * judgement, *[0.0] * 6))
        await asyncio.sleep(1.0)
        told = [news.about for news in script.news if isinstance(news, LinkTrouble)]
        assert told == (["numbers"] if judgement == 2 else [])


@pytest.mark.parametrize(
    ("system", "component", "kind"), [(SYSTEM + 1, 1, 2), (SYSTEM, 2, 2), (SYSTEM, 1, mavlink.MAV_TYPE_GCS)]
)
@played(tell)
async def test_heartbeats_of_others_say_nothing_of_the_vehicle(
    script: Script, *, system: int, component: int, kind: int
) -> None:
    other, loiter = mavlink.MAVLink(None, system, component), mavlink.COPTER_MODE_LOITER
    beat = mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 209, loiter, 4, 3)
    script._line.datagram_received(bytes(beat.pack(other)), ("", 1))
    await asyncio.sleep(0)
    assert script.autopilot.vehicle.mode_name == "GUIDED"
    assert not script.autopilot.armed


@pytest.mark.parametrize(
    ("kind", "blind"), [("HEARTBEAT", True), ("POSITION_TARGET_GLOBAL_INT", True), ("ATTITUDE", False)]
)
@played(tell)
async def test_a_vehicle_whose_owner_cannot_be_told_is_silent_for_a_second_and_a_half(
    script: Script, *, kind: str, blind: bool
) -> None:
    fails, vehicle = [True], script.autopilot.vehicle

    def hear(message: mavlink.MAVLink_message) -> None:
        if fails[0] and message.get_type() == kind:
            raise ZeroDivisionError

    reports = [script.heartbeat(), target(HERE), mavlink.MAVLink_attitude_message(1, *[0.0] * 6)]
    reports.sort(key=lambda message: bool(message.get_type() != kind))
    script.mute = True
    await script.say(script.place(HERE))
    await asyncio.sleep(0.125)
    with vehicle.listening(hear):
        await script.say(*reports)
        for wait_s, silent in (0.0, blind), (1.5, blind), (0.0625, False):
            await asyncio.sleep(wait_s)
            await script.say(script.place(HERE))
            assert (vehicle.silent_s > 0) is silent
        await script.say(*reports)
        fails[0] = False
        await asyncio.sleep(0.25)
        await script.say(*reports)
        assert vehicle.silent_s == 0, "a defect that is over"


@played(tell)
async def test_each_text_is_told_once(script: Script) -> None:
    for words in b"one", b"two":
        await script.say(mavlink.MAVLink_statustext_message(4, words), script.heartbeat())
    assert [news.text for news in script.news if isinstance(news, VehicleSaid)] == ["one", "two"]


# --- who has it ---------------------------------------------------------------------------------------------


@played(tell, flies=True)
async def test_a_clock_that_starts_anew_in_flight_is_a_restart(script: Script) -> None:
    attitude = mavlink.MAVLink_attitude_message
    await script.say(attitude(600_000, *[0.0] * 6))
    await asyncio.sleep(2.0)
    await script.say(attitude(602_000, *[0.0] * 6))
    await asyncio.sleep(2.0)
    assert script.autopilot.control.is_ours
    await script.say(attitude(5_000, *[0.0] * 6))
    control = script.autopilot.control
    assert control.owner is Owner.UNKNOWN
    assert control.why == "its autopilot restarted: its clock went from 602 s after boot to 5 s"
    assert script.news[-1] == control
    assert script.autopilot.vehicle.telemetry.stands is None


@pytest.mark.parametrize(
    ("stood_s", "why"),
    [(1.0, "its motors stopped in the air"), (1.0 + 1 / 16, "it was disarmed on the ground")],
)
@played(tell, flies=True)
async def test_motors_stop_on_the_ground_after_a_second_there(
    script: Script, *, stood_s: float, why: str
) -> None:
    script.mute = True
    await asyncio.sleep(0.25)  # another vehicle's heartbeats may come between two of its own
    await script.say(landed(IN_AIR))
    await script.say(landed(ON_GROUND))
    await asyncio.sleep(stood_s)
    script.sent.clear()
    await script.beat(armed=False)
    assert script.autopilot.control.is_ours, "one heartbeat may be a bridge's old one"
    await script.beat()
    assert script.autopilot.control.owner is Owner.UNKNOWN
    assert script.autopilot.control.why.startswith(why)
    assert script.asked_for(TIME) == [script.now_s], "its clock shows whether it restarted"
    script.sent.clear()
    await asyncio.sleep(0.25)
    await script.beat()
    assert script.asked_for(TIME) == []


@played(tell, flies=True)
async def test_no_clock_is_asked_for_where_the_program_stops_the_motors(script: Script) -> None:
    script.autopilot.vehicle.latch.expect_armed(False)
    script.sent.clear()
    await script.beat(armed=False)
    assert script.autopilot.control.is_ours
    assert script.asked_for(TIME) == []


@played(tell, flies=True)
async def test_one_disarmed_heartbeat_is_no_stop_of_the_motors_but_holds_back_commands(
    script: Script,
) -> None:
    """A bridge repeats an old heartbeat, of another mode."""
    script.mute = True
    script.sent.clear()
    await script.beat(armed=False, mode=mavlink.COPTER_MODE_STABILIZE)
    assert script.autopilot.control.is_ours and script.autopilot.armed
    assert script.asked_for(HEARTBEAT) == [script.now_s]
    holding = asyncio.ensure_future(script.autopilot.hold())
    await asyncio.sleep(1.0)
    assert script.commands(mavlink.MAV_CMD_DO_REPOSITION) == []
    await script.beat(armed=True, mode=mavlink.COPTER_MODE_GUIDED)
    await asyncio.sleep(0.1)
    assert script.commands(mavlink.MAV_CMD_DO_REPOSITION) != []
    assert script.autopilot.control.is_ours
    holding.cancel()


@played(tell, flies=True)
async def test_a_second_vehicle_that_says_disarmed_between_two_heartbeats_stops_no_motors(
    script: Script,
) -> None:
    """It stands, and answers the question for a heartbeat before the vehicle in flight does."""
    script.mute = True
    for _ in range(5):
        await script.say(landed(IN_AIR))
        await script.beat(armed=True, mode=mavlink.COPTER_MODE_GUIDED)
        await asyncio.sleep(0.9)
        script.sent.clear()
        for _ in range(2):
            await script.say(landed(ON_GROUND))
            await script.beat(armed=False, mode=mavlink.COPTER_MODE_STABILIZE)
        assert script.asked_for(HEARTBEAT) == [script.now_s]
        assert script.autopilot.control.is_ours and script.autopilot.armed
        await asyncio.sleep(0.1)


@pytest.mark.parametrize(("mode", "ordered"), [("RTL", "return"), ("LAND", "land")])
@played(tell, armed=True)
async def test_a_vehicle_that_comes_down_as_an_earlier_run_commanded_is_no_pilots(
    script: Script, *, mode: str, ordered: ComingDown
) -> None:
    await script.beat(mode=getattr(mavlink, f"COPTER_MODE_{mode}"))
    script.sent.clear()
    with pytest.raises(
        AutopilotOverruled, match=f"in mode {mode}, as that run commanded; wait for the landing"
    ):
        await script.autopilot.claim(resumes=True, ordered=ordered)
    assert script.autopilot.control.owner is Owner.EARLIER_RUN
    assert [message.get_type() for _, message in script.sent if message.get_type() != "HEARTBEAT"] == []


@played(tell)
async def test_a_claim_is_told(script: Script) -> None:
    await script.autopilot.claim(resumes=False)
    assert script.autopilot.control.is_ours
    assert script.news == [script.autopilot.control]


@played(tell, armed=True)
async def test_the_refusal_of_a_claim_is_told(script: Script) -> None:
    with pytest.raises(AutopilotOverruled, match="it is armed, in mode GUIDED"):
        await script.autopilot.claim(resumes=False)
    assert script.news == [script.autopilot.control]


# --- whether it stands --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("armed", "altitude_m", "stands"),
    [
        (False, None, True),
        (False, 1.0, True),
        (False, -1.0, True),
        (False, 1.1, False),
        (True, 0.0, False),
        (True, None, False),
    ],
)
@played(tell)
async def test_without_a_landed_state_it_stands_if_it_is_low_with_stopped_motors(
    script: Script, *, armed: bool, altitude_m: float | None, stands: bool
) -> None:
    await script.beat(armed=armed)
    if altitude_m is not None:
        await script.say(script.place(Position(0.0, 0.0, altitude_m)))
    assert script.autopilot.stands is stands


@pytest.mark.parametrize(
    ("after_s", "up_m_s", "stands"),
    [(0.25, 0.0, False), (0.3125, 0.0, True), (0.5, -1.0, True), (0.5, -1.01, False)],
)
@played(tell)
async def test_after_its_motors_stopped_it_stands_once_it_is_seen_not_to_fall(
    script: Script, *, after_s: float, up_m_s: float, stands: bool
) -> None:
    script.mute = True
    await script.beat(armed=True)
    await script.say(landed(ON_GROUND), script.place(HERE))
    assert script.autopilot.stands, "armed"
    await script.beat(armed=False)
    await script.beat()
    assert not script.autopilot.stands
    await asyncio.sleep(after_s)
    await script.say(script.place(HERE, Velocity(up_m_s=up_m_s)))
    assert script.autopilot.stands is stands


@played(tell)
async def test_whether_it_flies_waits_for_a_landed_state_and_a_place(script: Script) -> None:
    assert not await script.autopilot.in_the_air(), "its motors do not run"
    await script.beat(armed=True)
    asking = asyncio.create_task(script.autopilot.in_the_air())
    for report in landed(IN_AIR), script.place(HERE):
        await asyncio.sleep(1.0)
        assert not asking.done()
        await script.say(report)
    assert await asking
    await script.say(landed(ON_GROUND))
    assert not await script.autopilot.in_the_air()
    await script.say(landed(0))
    begun_s = script.now_s
    with pytest.raises(AutopilotTimeout, match="start: not done within 60 s"):
        await script.autopilot.in_the_air()
    assert script.now_s - begun_s == pytest.approx(60.0, abs=0.1)


@pytest.mark.parametrize(("told_after_s", "waits_s"), [(0.5, 0.5), (None, 2.0)])
@played(tell)
async def test_the_end_of_a_flight_waits_for_the_clock(
    script: Script, *, told_after_s: float | None, waits_s: float
) -> None:
    await script.beat(armed=True)
    await script.say(landed(ON_GROUND), script.place(HERE))
    stood = asyncio.create_task(script.autopilot.stood())
    await asyncio.sleep(5.0)
    assert not stood.done()
    await script.beat(armed=False)
    await asyncio.sleep(0.5)
    await script.say(script.place(HERE))
    begun_s = script.now_s
    if told_after_s is not None:
        await asyncio.sleep(told_after_s)
        assert not stood.done()
        await script.say(mavlink.MAVLink_system_time_message(0, round(script.now_s * 1e3)))
    await stood
    assert script.now_s - begun_s == pytest.approx(waits_s, abs=0.01)


# --- where it is --------------------------------------------------------------------------------------------


def position_jumps(script: Script) -> list[float]:
    return [news.jumped_m for news in script.news if isinstance(news, PositionDoubted)]


def fix(script: Script, place: Position, kind: int = 3) -> mavlink.MAVLink_message:
    geo = FRAME.geo(place)
    lat, lon = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
    return mavlink.MAVLink_gps_raw_int_message(round(script.now_s * 1e6), kind, lat, lon, 0, 100, 0, 0, 0, 9)


def near(place: Position, altitude_m: float = 10.0) -> object:
    return pytest.approx((place.east_m, place.north_m, altitude_m), abs=0.02)


def parts(place: Position | None) -> tuple[float, float, float]:
    assert place is not None
    return place.east_m, place.north_m, place.altitude_m


@played(tell)
async def test_before_its_first_report_it_is_at_home(script: Script) -> None:
    assert script.autopilot.position == Position(0.0, 0.0, 0.0)
    assert script.autopilot.earth_position is None
    assert script.autopilot.energy.home is None
    await script.say(script.place(HERE))
    assert parts(script.autopilot.position) == near(HERE)


def home(place: Position, altitude_m: float) -> mavlink.MAVLink_message:
    geo = FRAME.geo(place)
    lat, lon = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
    return mavlink.MAVLink_home_position_message(
        lat, lon, round(altitude_m * 1e3), 0, 0, 0, [1, 0, 0, 0], 0, 0, 0
    )


@pytest.mark.parametrize(
    ("east_m", "above_m", "told"), [(0.5, 0.5, False), (1.5, 0.0, True), (0.0, -3.0, True)]
)
@played(tell, armed=True)
async def test_a_home_that_moves_in_flight_is_told_and_changes_no_altitude(
    script: Script, *, east_m: float, above_m: float, told: bool
) -> None:
    await script.say(home(Position(9.0, 0.0), HOME_ABOVE_SEA_M))
    await script.resumed(HERE)
    moved = Position(9.0 + east_m, 0.0)
    await script.say(home(moved, HOME_ABOVE_SEA_M + above_m))
    assert parts(script.autopilot.energy.home) == near(moved, 0.0)
    place = script.place(HERE)
    place.relative_alt -= round(above_m * 1e3)
    await script.say(place, home(moved, HOME_ABOVE_SEA_M + above_m))
    assert parts(script.autopilot.position) == near(HERE)
    homes = [news for news in script.news if isinstance(news, HomeMoved)]
    assert len(homes) == told
    if told:
        assert (homes[0].east_m, homes[0].altitude_m) == pytest.approx((moved.east_m, above_m), abs=0.02)


@played(tell)
async def test_a_home_that_moves_before_the_flight_is_not_told(script: Script) -> None:
    await script.say(script.place(HERE), home(Position(0.0, 0.0), 488.0), home(Position(90.0, 0.0), 488.0))
    assert not any(isinstance(news, HomeMoved) for news in script.news)


@played(tell, flies=True)
async def test_a_jump_in_flight_is_told_until_the_receiver_agrees(script: Script) -> None:
    there = Position(HERE.east_m + 60.0, HERE.north_m, HERE.altitude_m)
    for _ in range(8):
        await asyncio.sleep(0.25)
        await script.say(script.place(HERE), fix(script, there))
    assert script.autopilot.vehicle.hindrance() == ""
    assert position_jumps(script) == []
    await asyncio.sleep(0.25)
    await script.say(script.place(there))
    assert position_jumps(script) == []  # the receiver was there before
    for _ in range(3):
        await asyncio.sleep(0.25)
        await script.say(script.place(HERE), fix(script, HERE, kind=2))  # without a height it is no place
    assert position_jumps(script) == [60.0]
    assert (
        script.autopilot.vehicle.hindrance() == ": its reported position jumped 60 m, farther than it can fly"
    )
    await asyncio.sleep(0.25)
    await script.say(script.place(there), fix(script, there))
    assert position_jumps(script) == [60.0, 0.0]
    assert script.autopilot.vehicle.hindrance() == ""


@pytest.mark.parametrize(("unsure_s", "told"), [(1.0, []), (4.0, [True, False])])
@played(tell, flies=True)
async def test_a_vehicle_that_is_unsure_of_its_place_for_long_is_told(
    script: Script, *, unsure_s: float, told: list[bool]
) -> None:
    begun_s = script.now_s
    while (passed_s := script.now_s - begun_s) < 8.0:
        flags = mavlink.EKF_CONST_POS_MODE if passed_s < unsure_s else mavlink.EKF_POS_HORIZ_ABS
        await script.say(mavlink.MAVLink_ekf_status_report_message(flags, *[0.0] * 5), script.place(HERE))
        await asyncio.sleep(0.5)
    doubts = [news for news in script.news if isinstance(news, PositionDoubted)]
    assert [(doubt.jumped_m, doubt.unsure) for doubt in doubts] == [(0.0, unsure) for unsure in told]


async def jump_to_and_fro(script: Script, times: int) -> None:
    """Its place jumps that often, once in a quarter of a second, while it stands."""
    for number in range(times + 1):
        await script.say(script.place(Position(60.0 * (number % 2), 0.0)))
        await asyncio.sleep(0.25)


async def may_be_armed(script: Script) -> None:
    """Its own checks pass, and it knows its place."""
    checked = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    await script.say(
        mavlink.MAVLink_sys_status_message(checked, checked, checked, 0, 12_000, 0, 99, *[0] * 6),
        mavlink.MAVLink_ekf_status_report_message(mavlink.EKF_POS_HORIZ_ABS, *[0.0] * 5),
    )


@played(tell)
async def test_a_place_that_jumps_on_the_ground_delays_arming_for_five_seconds(script: Script) -> None:
    await script.autopilot.claim(resumes=False)
    await may_be_armed(script)
    await script.autopilot.ready()
    script.news.clear()
    await jump_to_and_fro(script, 1)
    jumped_s = script.now_s - 0.25
    waiting = asyncio.create_task(script.autopilot.ready())
    await asyncio.sleep(0)
    delayed = ArmingDelayed(reasons=("its reported position jumped 60 m while it stands",))
    while not waiting.done() and script.now_s < 60.0:
        await script.say(script.place(Position(60.0, 0.0)))
        await asyncio.sleep(0.0625)
    await waiting
    assert script.now_s - jumped_s == pytest.approx(
        5.0 + 2 * 0.0625
    )  # the next report, and the wait after it
    assert script.news == [delayed], "a vehicle that stands is doubted no more"
    assert script.autopilot.vehicle.hindrance() == ""


@pytest.mark.parametrize("times", [2, 3])
@played(tell)
async def test_a_place_that_jumps_three_times_in_five_seconds_is_that_of_two_vehicles(
    script: Script, *, times: int
) -> None:
    await script.autopilot.claim(resumes=False)
    await may_be_armed(script)
    await jump_to_and_fro(script, times)
    if times == 3:
        with pytest.raises(
            AutopilotRefused, match=r"jumped 60 m while it stands, again.*system 7 on this link"
        ):
            await script.autopilot.ready()
    else:
        await script.autopilot.ready()


def target(place: Position) -> mavlink.MAVLink_message:
    geo = FRAME.geo(place)
    lat, lon = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
    return mavlink.MAVLink_position_target_global_int_message(
        1, 5, 0, lat, lon, HOME_ABOVE_SEA_M + place.altitude_m, *[0.0] * 8
    )


def local_target(mask: int) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_position_target_local_ned_message(1, 1, mask, *[0.0] * 11)


SENT_AWAY = "60 m from where the program sent it"


@pytest.mark.parametrize("mode", [mavlink.COPTER_MODE_GUIDED, mavlink.COPTER_MODE_RTL])
@pytest.mark.parametrize(
    ("report", "why"),
    [
        (target(Position(30.5, 40.5, 10.5)), ""),
        (target(Position(90.0, 40.0, 10.0)), f"it was sent to 90 m east, 40 m north, {SENT_AWAY}"),
        (target(Position(30.0, 40.0, 70.0)), f"it was sent to 30 m east, 40 m north, {SENT_AWAY}"),
        (local_target(0b111), "it follows a velocity that the program did not command"),
        (local_target(0b011), ""),
    ],
)
@played(tell, flies=True)
async def test_a_target_that_the_program_did_not_send_is_a_ground_stations(
    script: Script, *, mode: int, report: object, why: str
) -> None:
    vehicle = script.autopilot.vehicle
    await script.say(target(HERE))
    vehicle.latch.expect_modes(("RTL",))
    await script.beat(mode=mode)
    vehicle.latch.withdraw()
    await script.say(report)
    steers = mode == mavlink.COPTER_MODE_GUIDED
    assert vehicle.latch.control.owner is (Owner.GROUND_STATION if why and steers else Owner.PROGRAM)
    assert not steers or why in vehicle.latch.control.why
