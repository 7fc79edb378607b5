"""What a program sees of the stand-in, row by row what a real ArduCopter was seen to do."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.vehicle.direct import directly_linked

from upwash.core.geo import GeoPosition
from upwash.errors import UsageError
from upwash.mavlink.version import Version
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.connection import StandIn
from upwash.vehicle.body.copter import FaultKind, VehicleFault, read_fault
from upwash.vehicle.body.parameters import read_setting

HOME = GeoPosition(39.3666, 22.9507)
SETTINGS = VehicleSettings(home=HOME, armable_after_s=0.0)
BOOTING = replace(SETTINGS, armable_after_s=10.0)
EXTENDED_STATE = mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
GLOBAL_POSITION = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
MOST_S = 300.0


class Client:
    """Says what it likes and keeps all that it hears."""

    def __init__(self) -> None:
        self.heard: list[Any] = []
        self.say: Callable[[Any], None] = lambda _: None
        self._news = asyncio.Event()

    def hear(self, message: Any) -> None:
        self.heard.append(message)
        self._news.set()

    def all(self, kind: str) -> list[Any]:
        return [message for message in self.heard if message.get_type() == kind]

    async def until(self, condition: Callable[[], Any]) -> None:
        async with asyncio.timeout(MOST_S):
            while not condition():
                self._news.clear()
                await self._news.wait()

    async def next(self, kind: str) -> Any:
        known = len(self.all(kind))
        await self.until(lambda: len(self.all(kind)) > known)
        return self.all(kind)[known]

    async def long(self, number: int, *parameters: float) -> int:
        padded = (*parameters, *[0.0] * (7 - len(parameters)))
        self.say(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded))
        return int((await self.next("COMMAND_ACK")).result)

    async def placed(self, number: int, frame: int, x: int, y: int, z: float, *, flags: float = 0) -> int:
        self.say(mavlink.MAVLink_command_int_message(1, 1, frame, number, 0, 0, 0, flags, 0, 0, x, y, z))
        return int((await self.next("COMMAND_ACK")).result)

    async def stream(self, number: int, *, every_s: float = 0.1) -> None:
        assert await self.long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, every_s * 1e6) == 0

    async def take_off(self, altitude_m: float = 10.0) -> None:
        await self.stream(GLOBAL_POSITION)
        assert await self.long(mavlink.MAV_CMD_DO_SET_MODE, 1, mavlink.COPTER_MODE_GUIDED) == 0
        assert await self.long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
        assert await self.long(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, altitude_m) == 0
        await self.until(
            lambda: (
                (reports := self.all("GLOBAL_POSITION_INT")) and reports[-1].relative_alt > altitude_m * 990
            )
        )

    def target(self, *, east_e7: int, altitude_m: float = 10.0) -> None:
        self.say(
            mavlink.MAVLink_set_position_target_global_int_message(
                0, 1, 1, 6, 0b110111111000, 393_666_000, 229_507_000 + east_e7, altitude_m, *[0] * 8
            )
        )

    def beats(self) -> list[tuple[int, int, int]]:
        """The heartbeats' base mode, custom mode and status, each as long as it stays once."""
        states: list[tuple[int, int, int]] = []
        for beat in self.all("HEARTBEAT"):
            state = beat.base_mode, beat.custom_mode, beat.system_status
            if not states or states[-1] != state:
                states.append(state)
        return states

    def landed_states(self) -> list[int]:
        states: list[int] = []
        for report in self.all("EXTENDED_SYS_STATE"):
            if not states or states[-1] != report.landed_state:
                states.append(report.landed_state)
        return states


def talk(
    scenario: Callable[[Client, StandIn], Awaitable[None]], settings: VehicleSettings = SETTINGS
) -> None:
    async def talked() -> None:
        client = Client()
        async with directly_linked(settings, client.hear) as (vehicle, client.say):
            await scenario(client, vehicle)

    run_virtually(talked())


@played(talk, BOOTING)
async def test_on_connect_it_says_only_that_it_lives_until_it_is_asked(client: Client) -> None:
    await client.until(lambda: len(client.all("HEARTBEAT")) > 12 and client.all("TIMESYNC"))
    by_itself = {"HEARTBEAT", "TIMESYNC", "STATUSTEXT", "GPS_GLOBAL_ORIGIN", "HOME_POSITION"}
    assert {message.get_type() for message in client.heard} == by_itself
    assert len(client.all("GPS_GLOBAL_ORIGIN")) == len(client.all("HOME_POSITION")) == 1


@played(talk)
async def test_data_streams_bring_everything_but_the_landed_state(client: Client) -> None:
    client.say(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_ALL, 10, 1))
    wanted = {"GLOBAL_POSITION_INT", "SYS_STATUS", "ATTITUDE", "EKF_STATUS_REPORT", "BATTERY_STATUS"}
    await client.until(lambda: wanted <= {message.get_type() for message in client.heard})
    assert not client.all("EXTENDED_SYS_STATE")
    client.say(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_ALL, 10, 0))
    await client.long(mavlink.MAV_CMD_REQUEST_MESSAGE, EXTENDED_STATE)
    known = len(client.all("ATTITUDE"))
    await client.next("HEARTBEAT")
    assert len(client.all("ATTITUDE")) == known


@played(talk, BOOTING)
async def test_until_it_can_be_armed_it_says_why_and_its_filter_shows_when(client: Client) -> None:
    await client.stream(mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT)
    await client.stream(GLOBAL_POSITION)
    await client.stream(mavlink.MAVLINK_MSG_ID_SYS_STATUS)
    assert await client.long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 4
    text = client.all("STATUSTEXT")[-1]
    assert (text.severity, text.text) == (2, "Arm: System not initialised")
    assert client.all("EKF_STATUS_REPORT")[0].flags != 831
    assert (client.all("GLOBAL_POSITION_INT")[0].lat, client.all("GLOBAL_POSITION_INT")[0].lon) == (0, 0)
    healthy = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert not client.all("SYS_STATUS")[0].onboard_control_sensors_health & healthy
    await client.until(lambda: client.all("EKF_STATUS_REPORT")[-1].flags == 831)
    assert await client.long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0


@played(talk, BOOTING)
async def test_heartbeats_and_landed_states_come_in_the_recorded_order(client: Client) -> None:
    await client.stream(EXTENDED_STATE)
    await client.stream(mavlink.MAVLINK_MSG_ID_HEARTBEAT)  # often enough to miss no state
    await client.until(lambda: client.beats()[-1] == (81, 0, 3))
    await client.until(lambda: client.all("GPS_GLOBAL_ORIGIN"))
    await client.until(
        lambda: "EKF3 IMU0 is using GPS" in [message.text for message in client.all("STATUSTEXT")]
    )
    assert await client.long(mavlink.MAV_CMD_DO_SET_MODE, 1, mavlink.COPTER_MODE_GUIDED) == 0
    await client.until(lambda: client.beats()[-1] == (89, 4, 3))
    told = len(client.all("HOME_POSITION"))
    assert await client.long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    await client.until(lambda: len(client.all("HOME_POSITION")) == told + 1)
    await client.until(lambda: client.beats()[-1] == (217, 4, 3))
    assert await client.long(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0) == 0
    await client.until(lambda: client.landed_states()[-1] == 2)
    assert await client.long(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    await client.until(lambda: client.beats()[-1] == (81, 6, 3))
    assert client.beats() == [
        (89, 0, 1),
        (81, 0, 3),
        (89, 4, 3),
        (217, 4, 3),
        (217, 4, 4),
        (217, 6, 4),
        (217, 6, 3),
        (81, 6, 3),
    ]
    assert client.landed_states() == [1, 3, 2, 4, 1]


@played(talk)
async def test_the_answers_to_commands(client: Client) -> None:
    long = client.long
    assert await long(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0) == 4  # disarmed
    assert await long(mavlink.MAV_CMD_DO_PARACHUTE) == 3
    assert await long(mavlink.MAV_CMD_DO_SET_MODE, 0, 4) == 2
    await client.take_off()
    assert await long(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 20.0) == 4  # airborne
    assert await long(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 0.0) == 2
    assert await long(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 5.0) == 0
    assert await long(mavlink.MAV_CMD_REQUEST_MESSAGE, 242) == 0
    assert await long(mavlink.MAV_CMD_REQUEST_MESSAGE, 9999) == 4
    assert await long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) == 4  # in flight
    assert await long(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    reposition = mavlink.MAV_CMD_DO_REPOSITION
    assert await client.placed(reposition, 6, 393_668_000, 229_507_000, 10.0) == 2  # outside GUIDED
    assert await client.placed(reposition, 6, 393_668_000, 229_507_000, 10.0, flags=1) == 0
    await client.stream(mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT)
    assert (await client.next("POSITION_TARGET_GLOBAL_INT")).lat_int == pytest.approx(393_668_000, abs=1)
    assert await long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == 0  # forced: it falls
    await client.until(lambda: client.all("GLOBAL_POSITION_INT")[-1].relative_alt == 0)


@played(talk)
async def test_a_mode_set_the_old_way_changes_without_an_answer(client: Client) -> None:
    client.say(mavlink.MAVLink_set_mode_message(1, 1, mavlink.COPTER_MODE_GUIDED))
    await client.until(lambda: client.all("HEARTBEAT")[-1].custom_mode == mavlink.COPTER_MODE_GUIDED)
    assert not client.all("COMMAND_ACK")


@pytest.mark.parametrize(
    "mode", [mavlink.COPTER_MODE_LOITER, mavlink.COPTER_MODE_BRAKE, mavlink.COPTER_MODE_STABILIZE]
)
@played(talk)
async def test_targets_are_ignored_in_silence_outside_guided(client: Client, *, mode: int) -> None:
    await client.take_off()
    assert await client.long(mavlink.MAV_CMD_DO_SET_MODE, 1, mode) == 0
    answers = len(client.all("COMMAND_ACK"))
    client.target(east_e7=2_000)
    for _ in range(5):
        await client.next("HEARTBEAT")
    assert abs(client.all("GLOBAL_POSITION_INT")[-1].lon - 229_507_000) <= 1
    assert len(client.all("COMMAND_ACK")) == answers


@played(talk)
async def test_a_speed_is_lost_before_the_first_target_and_kept_after_it(client: Client) -> None:
    await client.take_off()
    assert await client.long(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 3.0) == 0
    client.target(east_e7=20_000)
    await client.until(lambda: max(message.vy for message in client.all("GLOBAL_POSITION_INT")) >= 539)
    assert await client.long(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 3.0) == 0
    await client.until(lambda: 295 <= client.all("GLOBAL_POSITION_INT")[-1].vy <= 301)
    await client.until(lambda: client.all("GLOBAL_POSITION_INT")[-1].lon > 229_507_000 + 10_000)
    assert await client.long(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    await client.until(lambda: client.all("GLOBAL_POSITION_INT")[-1].vy <= -800)  # at a speed of its own


@played(talk)
async def test_parameters_are_listed_read_and_set(client: Client) -> None:
    client.say(mavlink.MAVLink_param_request_list_message(1, 1))
    await client.until(lambda: (told := client.all("PARAM_VALUE")) and len(told) == told[0].param_count)
    told = client.all("PARAM_VALUE")
    assert sorted(each.param_index for each in told) == list(range(len(told)))
    client.say(mavlink.MAVLink_param_set_message(1, 1, b"RTL_ALT", 3_000, 6))
    assert (await client.next("PARAM_VALUE")).param_value == 3_000
    client.say(mavlink.MAVLink_param_request_read_message(1, 1, b"RTL_ALT", -1))
    assert (await client.next("PARAM_VALUE")).param_value == 3_000
    await client.take_off()
    assert await client.long(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    await client.until(lambda: client.all("GLOBAL_POSITION_INT")[-1].relative_alt > 29_900)


@played(talk)
async def test_it_has_no_mission_and_takes_none(client: Client) -> None:
    client.say(mavlink.MAVLink_mission_request_list_message(1, 1))
    assert (await client.next("MISSION_COUNT")).count == 0
    client.say(mavlink.MAVLink_mission_count_message(1, 1, 3))
    assert (await client.next("MISSION_ACK")).type == mavlink.MAV_MISSION_UNSUPPORTED


FENCED = replace(SETTINGS, parameters={"FENCE_ENABLE": 1, "FENCE_TYPE": 6, "FENCE_RADIUS": 60})
FenceRow = tuple[int, float, int, int]
INCLUSION = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
KEEP_OUT = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
SQUARE: list[FenceRow] = [
    (INCLUSION, 4, north, east) for north, east in ((-3, -4), (-3, 4), (3, 4), (3, -4))
]  # 1e-4 degrees


async def upload_fence(client: Client, items: list[FenceRow]) -> int:
    fence = mavlink.MAV_MISSION_TYPE_FENCE
    client.say(mavlink.MAVLink_mission_count_message(1, 1, len(items), fence))
    for number, (command, first, north, east) in enumerate(items):
        assert (await client.next("MISSION_REQUEST")).seq == number
        place = 393_666_000 + north * 1_000, 229_507_000 + east * 1_000
        client.say(
            mavlink.MAVLink_mission_item_int_message(
                1, 1, number, 3, command, 0, 0, first, 0, 0, 0, *place, 0, fence
            )
        )
    return int((await client.next("MISSION_ACK")).type)


def test_a_fence_is_taken_and_given_back() -> None:
    items: list[FenceRow] = [*SQUARE, (KEEP_OUT, 5.0, 1, 1)]

    async def scenario(client: Client, vehicle: StandIn) -> None:
        assert await upload_fence(client, items) == mavlink.MAV_MISSION_ACCEPTED
        client.say(mavlink.MAVLink_mission_request_list_message(1, 1, 1))
        assert (await client.next("MISSION_COUNT")).count == len(items)
        for number, (command, first, north, east) in enumerate(items):
            client.say(mavlink.MAVLink_mission_request_int_message(1, 1, number, 1))
            item = await client.next("MISSION_ITEM_INT")
            assert (item.seq, item.command, item.param1, item.mission_type) == (number, command, first, 1)
            assert (item.x, item.y) == (393_666_000 + north * 1_000, 229_507_000 + east * 1_000)
        total = vehicle.firmware.copter.parameters.named("FENCE_TOTAL")
        assert total is not None and total.param_value == len(items)
        client.say(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
        assert (await client.next("MISSION_COUNT")).count == 0

    talk(scenario, FENCED)


@pytest.mark.parametrize(
    "wrong",
    [SQUARE[:2], [(INCLUSION, math.inf, 0, 0)], [(KEEP_OUT, math.nan, 0, 0)], [(KEEP_OUT, 5.0, 900_000, 0)]],
    ids=["too few corners", "endless corners", "no radius", "beyond the pole"],
)
@played(talk, FENCED)
async def test_a_fence_that_is_none_is_refused_in_words_and_leaves_none(
    client: Client, *, wrong: list[FenceRow]
) -> None:
    assert await upload_fence(client, SQUARE) == mavlink.MAV_MISSION_ACCEPTED
    assert await upload_fence(client, wrong) == mavlink.MAV_MISSION_ERROR
    await client.until(lambda: client.all("STATUSTEXT")[-1].text == "Fence validation failed")
    client.say(mavlink.MAVLink_mission_request_list_message(1, 1, 1))
    assert (await client.next("MISSION_COUNT")).count == 0


@played(talk, FENCED)
async def test_targets_outside_the_fence_are_failed_or_ignored_in_silence(client: Client) -> None:
    assert await upload_fence(client, [*SQUARE, (KEEP_OUT, 5.0, 1, 1)]) == 0
    await client.take_off()
    reposition = mavlink.MAV_CMD_DO_REPOSITION
    answers = [
        await client.placed(reposition, 6, 393_666_000 + north, 229_507_000 + east, 10.0)
        for north, east in ((0, 1_500), (0, 5_000), (1_000, 1_000), (9_000, 0))
    ]
    assert answers == [0, 4, 4, 4]
    texts = len(client.all("STATUSTEXT"))
    client.target(east_e7=5_000)
    await asyncio.sleep(20.0)
    assert client.all("GLOBAL_POSITION_INT")[-1].lon == pytest.approx(229_508_500, abs=20)
    assert len(client.all("STATUSTEXT")) == texts


@played(talk, replace(FENCED, parameters={"FENCE_ENABLE": 1, "FENCE_TYPE": 4}))
async def test_a_fence_of_areas_without_any_keeps_it_on_the_ground(client: Client) -> None:
    assert await client.long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 4
    assert client.all("STATUSTEXT")[-1].text == "Arm: Fences enabled, but none selected"


@played(talk)
async def test_heartbeats_come_at_the_interval_that_was_asked_for(client: Client) -> None:
    for interval_us, beats, told_us in (200_000, 50, 200_000), (-1, 0, -1), (0, 10, 1_000_000):
        assert await client.long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, interval_us) == 0
        known = len(client.all("HEARTBEAT"))
        await asyncio.sleep(10.0)
        assert len(client.all("HEARTBEAT")) - known == pytest.approx(beats, abs=1)
        assert await client.long(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, 0) == 0
        assert client.all("MESSAGE_INTERVAL")[-1].interval_us == told_us


@played(talk, replace(BOOTING, clock_offset_s=3_600.0))
async def test_it_tells_its_home_and_the_time_of_day(client: Client) -> None:
    assert await client.long(mavlink.MAV_CMD_GET_HOME_POSITION) == 4  # it does not know it yet
    assert await client.long(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME) == 0
    assert client.all("SYSTEM_TIME")[-1].time_unix_usec == 0
    await client.until(lambda: client.all("HOME_POSITION"))
    assert await client.long(mavlink.MAV_CMD_GET_HOME_POSITION) == 0
    home = client.all("HOME_POSITION")[-1]
    assert (home.latitude, home.longitude) == (393_666_000, 229_507_000)
    assert await client.long(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME) == 0
    told_s = client.all("SYSTEM_TIME")[-1].time_unix_usec / 1e6
    assert told_s == pytest.approx(time.time() + 3_600, abs=60.0)


@played(talk, replace(BOOTING, clock_offset_s=0.0, speedup=100.0))
async def test_a_vehicle_that_lives_faster_tells_the_computers_time_of_day(client: Client) -> None:
    await client.until(lambda: client.all("HOME_POSITION"))
    await asyncio.sleep(10.0)  # 1,000 of its own
    assert await client.long(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME) == 0
    told_s = client.all("SYSTEM_TIME")[-1].time_unix_usec / 1e6
    assert told_s == pytest.approx(time.time(), abs=60.0)


def test_the_ground_stations_silence_is_noticed_not_a_companions() -> None:
    def beat(system: int) -> bytes:
        codec = mavlink.MAVLink(None, srcSystem=system, srcComponent=190)
        return bytes(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(codec))

    async def scenario(client: Client, vehicle: StandIn) -> None:
        def say_as(system: int) -> None:
            (connection,) = vehicle.connections
            for message in mavlink.MAVLink(None).parse_buffer(beat(system)) or ():
                connection.hear(message)

        await client.take_off()
        for second in range(20):
            say_as(255 if second < 10 else 7)
            await asyncio.sleep(1.0)
        assert client.beats()[-1][1:] == (mavlink.COPTER_MODE_RTL, mavlink.MAV_STATE_CRITICAL)
        assert "GCS Failsafe" in [text.text for text in client.all("STATUSTEXT")]

    talk(scenario, replace(SETTINGS, parameters={"FS_GCS_ENABLE": 1}))


def test_a_parameter_that_it_does_not_have_is_refused() -> None:
    assert read_setting("FENCE_RADIUS=60") == ("FENCE_RADIUS", 60.0)
    with pytest.raises(UsageError, match="FENCE_RADIUS=60"):
        read_setting("FENCE_RADIUS")
    with pytest.raises(UsageError, match="no parameter SYSID_THISMAV"):
        Copter(replace(SETTINGS, parameters={"SYSID_THISMAV": 1}), now_s=0.0)


@played(talk)
async def test_with_its_link_down_it_says_nothing_and_hears_nothing(client: Client, vehicle: StandIn) -> None:
    vehicle.firmware.copter.fail(FaultKind.LINK, vehicle.now_s())
    known = len(client.heard)
    client.say(mavlink.MAVLink_set_mode_message(1, 1, mavlink.COPTER_MODE_GUIDED))
    await asyncio.sleep(20.0)
    assert len(client.heard) == known
    vehicle.firmware.copter.mend(FaultKind.LINK)
    assert (await client.next("HEARTBEAT")).custom_mode == 0


@pytest.mark.parametrize("text", ["", "engine", "link:x", "gps:9-3", "gps:3-3", "battery:nan"])
def test_a_fault_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="write one of link, gps, glitch, battery"):
        read_fault(text)


def test_faults_are_read_with_their_times() -> None:
    assert read_fault("arming") == VehicleFault(FaultKind.ARMING)
    assert read_fault("link:30") == VehicleFault(FaultKind.LINK, 30.0)
    assert read_fault("gps:60-90") == VehicleFault(FaultKind.GPS, 60.0, 90.0)


@pytest.mark.parametrize(
    ("version", "name", "value"), [("4.7.0-dev", "RTL_ALT", 2_000.0), ("4.7.0", "RTL_ALT_M", 20.0)]
)
def test_parameters_have_the_names_and_units_of_the_version(version: str, name: str, value: float) -> None:
    async def scenario(client: Client, vehicle: StandIn) -> None:
        other = {"RTL_ALT": "RTL_ALT_M", "RTL_ALT_M": "RTL_ALT"}[name]
        for asked in (other, name):
            client.say(mavlink.MAVLink_param_request_read_message(1, 1, asked.encode(), -1))
        told = await client.next("PARAM_VALUE")
        assert (told.param_id, told.param_value) == (name, pytest.approx(value))
        client.say(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value / 2, told.param_type))
        assert (await client.next("PARAM_VALUE")).param_value == pytest.approx(value / 2)
        client.say(mavlink.MAVLink_command_long_message(1, 1, 520, 0, 1, *(0.0,) * 6))
        told = await client.next("AUTOPILOT_VERSION")
        assert Version.of(told.flight_sw_version) == Version.read(version)
        assert int.from_bytes(bytes(told.uid2), "little") == serial

    serial = 0 if version == "4.7.0" else 2**64 - 1
    talk(scenario, replace(SETTINGS, serial=serial, version=Version.read(version), parameters={name: value}))


def test_its_clock_in_timesync_counts_from_its_boot() -> None:
    async def scenario(client: Client, vehicle: StandIn) -> None:
        await asyncio.sleep(2.0)
        client.say(mavlink.MAVLink_timesync_message(0, 77))
        answer = await client.next("TIMESYNC")
        while answer.ts1 != 77:
            answer = await client.next("TIMESYNC")
        uptime_s = vehicle.firmware.copter.uptime_s(vehicle.now_s())
        assert answer.tc1 / 1e9 == pytest.approx(uptime_s, abs=0.5)

    talk(scenario, SETTINGS)


def test_a_serial_number_that_no_message_can_carry_is_refused() -> None:
    with pytest.raises(UsageError, match="serial is -1; give 0 to 18446744073709551615"):
        replace(SETTINGS, serial=-1)


def test_a_parameter_of_another_version_is_refused() -> None:
    with pytest.raises(
        UsageError, match=r"version 4\.7\.0 has no parameter RTL_ALT, or not with the value 2000"
    ):
        Copter(replace(SETTINGS, version=Version(4, 7), parameters={"RTL_ALT": 2_000.0}), now_s=0.0)


@pytest.mark.parametrize(
    ("command", "result"),
    [
        (mavlink.MAV_CMD_USER_1, mavlink.MAV_RESULT_UNSUPPORTED),
        (mavlink.MAV_CMD_USER_5, mavlink.MAV_RESULT_UNSUPPORTED),
        (mavlink.MAV_CMD_SET_CAMERA_MODE, mavlink.MAV_RESULT_UNSUPPORTED),
        (mavlink.MAV_CMD_VIDEO_START_CAPTURE, mavlink.MAV_RESULT_FAILED),
        (mavlink.MAV_CMD_VIDEO_STOP_CAPTURE, mavlink.MAV_RESULT_FAILED),
        (mavlink.MAV_CMD_DO_SET_SERVO, mavlink.MAV_RESULT_ACCEPTED),
    ],
)
@played(talk)
async def test_commands_of_payloads_have_its_answers(client: Client, *, command: int, result: int) -> None:
    assert await client.long(command, 1.0) == result


@played(talk)
async def test_each_photo_is_told_and_one_while_the_shutter_is_held_is_not_taken(client: Client) -> None:
    async def shoot() -> None:
        assert await client.long(mavlink.MAV_CMD_DO_DIGICAM_CONTROL, 0, 0, 0, 0, 1) == 0

    await shoot()
    await asyncio.sleep(0.02)
    await shoot()
    await asyncio.sleep(0.2)
    await shoot()
    assert await client.long(mavlink.MAV_CMD_DO_DIGICAM_CONTROL) == 0  # shoots nothing
    await asyncio.sleep(0.2)
    photos = client.all("CAMERA_FEEDBACK")
    assert [photo.img_idx for photo in photos] == [1, 2]
    assert photos[0].lat == round(HOME.latitude_deg * 1e7)
    assert photos[0].time_usec == pytest.approx(time.time() * 1e6, abs=1e9)
    assert await client.long(mavlink.MAV_CMD_IMAGE_START_CAPTURE) == mavlink.MAV_RESULT_ACCEPTED
    assert await client.long(mavlink.MAV_CMD_IMAGE_START_CAPTURE) == mavlink.MAV_RESULT_FAILED
