"""Messages with the vehicle's identity that cannot be true, or that the driver fails on, on virtual time."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.memory import Bench, driven
from tests.ports.steps import take_off

from upwash.core.geo import GeoPosition, Position
from upwash.core.vehicle.control import Control, Owner
from upwash.errors import AutopilotError, AutopilotOverruled
from upwash.eventlog.schema import ArmingDelayed, HomeMoved, LinkLost, LinkRestored, LinkTrouble, VehicleSaid
from upwash.mavlink.px4 import EventMessage, px4_events
from upwash.ports import VehicleNews
from upwash.real.mavlink import DriverPatience, MavlinkAutopilot
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.gate import admits
from upwash.real.mavlink.news import VehicleNewsFeed
from upwash.real.mavlink.px4_firmware import PX4
from upwash.real.mavlink.telemetry import VehicleTelemetry
from upwash.real.mavlink.vehicle import MavlinkVehicle
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.px4.settings import Px4Settings
from upwash.vehicle.server import serve_vehicle

HOME = GeoPosition(39.3666, 22.9507)
COPTER = VehicleSettings(HOME, home_altitude_m=488.0, armable_after_s=0.0)
FAR = Position(30.0, 0.0, 5.0)
HEARTBEAT = "HEARTBEAT"
LAT, LON, SEA_MM = 393_666_000, 229_507_000, 488_000


class Flight:
    """A driver with its stand-in, which says whatever it is told to say."""

    def __init__(self, sky: Bench, autopilot: MavlinkAutopilot) -> None:
        self.sky, self.autopilot = sky, autopilot
        self.vehicle: MavlinkVehicle = autopilot.vehicle
        self.news: list[VehicleNews] = []
        autopilot.listen(self.news.append)

    def troubles(self, about: str) -> list[str]:
        return [each.why for each in self.news if isinstance(each, LinkTrouble) and each.about == about]

    async def say(self, *messages: Any) -> None:
        for message in messages:
            self.sky.connection.send(message)
        await asyncio.sleep(0)
        await asyncio.sleep(0)


def fly(
    flight: Callable[[Flight], Awaitable[None]], settings: VehicleSettings | Px4Settings = COPTER
) -> None:
    async def flown() -> None:
        async with driven(settings) as (sky, autopilot):
            flown = Flight(sky, autopilot)
            await asyncio.sleep(5.05)  # it has reported all by then, and reports nothing just now
            await flight(flown)

    run_virtually(flown())


def position(**fields: int) -> Any:
    told = {"lat": LAT, "lon": LON, "alt": SEA_MM, "relative_alt": 0, **fields}
    return mavlink.MAVLink_global_position_int_message(1, vx=0, vy=0, vz=0, hdg=0, **told)


def home(**fields: int) -> Any:
    told = {"latitude": LAT, "longitude": LON, "altitude": SEA_MM, **fields}
    return mavlink.MAVLink_home_position_message(
        x=0, y=0, z=0, q=[1, 0, 0, 0], approach_x=0, approach_y=0, approach_z=0, **told
    )


def target(alt: float, lat: int = LAT) -> Any:
    return mavlink.MAVLink_position_target_global_int_message(1, 5, 0, lat, LON, alt, *[0.0] * 8)


def battery(percent: int) -> Any:
    return mavlink.MAVLink_battery_status_message(0, 0, 0, 0, [0] * 10, 0, 0, 0, percent)


DROPPED = {
    "wind from an infinite direction": mavlink.MAVLink_wind_message(math.inf, 3.0, 0.0),
    "wind from no direction": mavlink.MAVLink_wind_message(math.nan, 3.0, 0.0),
    "wind of no speed": mavlink.MAVLink_wind_message(0.0, math.nan, 0.0),
    "wind of 1e38 m/s": mavlink.MAVLink_wind_message(0.0, 1e38, 0.0),
    "attitude of no angle": mavlink.MAVLink_attitude_message(1, math.nan, 0, 0, 0, 0, 0),
    "attitude of 1e38": mavlink.MAVLink_attitude_message(1, 0, 0, -1e38, 0, 0, 0),
    "position beyond the pole": position(lat=2**31 - 1),
    "position beyond the date line": position(lon=-(2**31)),
    "position beyond the air": position(alt=2**31 - 1),
    "position below the sea": position(relative_alt=-(2**31)),
    "home beyond the pole": home(latitude=-(2**31)),
    "home beyond the air": home(altitude=2**31 - 1),
    "home below the sea": home(altitude=-(2**31)),
    "satellites beyond the pole": mavlink.MAVLink_gps_raw_int_message(1, 3, 2**31 - 1, LON, 0, 0, 0, 0, 0, 9),
    "target without an altitude": target(math.nan),
    "target at 1e38 m": target(1e38),
    "target beyond the pole": target(493.0, lat=2**31 - 1),
}


@pytest.mark.parametrize("message", DROPPED.values(), ids=DROPPED)
@played(fly)
async def test_a_message_that_cannot_be_true_changes_nothing_and_is_told(
    flown: Flight, *, message: Any
) -> None:
    told = flown.vehicle.telemetry
    before = (told.position, told.home, told.wind, told.attitude, told.gps)
    await flown.say(message)
    assert (told.position, told.home, told.wind, told.attitude, told.gps) == before
    (why,) = flown.troubles("out-of-range")
    assert message.get_type() in why and "dropped" in why


UNKNOWN = {
    "landed state 200": (mavlink.MAVLink_extended_sys_state_message(0, 200), "stands", None),
    "a time after the calendar": (mavlink.MAVLink_system_time_message(2**64 - 1, 1), "unix_s", None),
}


@pytest.mark.parametrize(("message", "name", "value"), UNKNOWN.values(), ids=UNKNOWN)
@played(fly)
async def test_a_number_that_cannot_be_true_counts_as_not_known(
    flown: Flight, *, message: Any, name: str, value: object
) -> None:
    await flown.say(message)
    assert getattr(flown.vehicle.telemetry, name) is value
    assert len(flown.troubles("out-of-range")) == 1


@pytest.mark.parametrize("percent", [127, -128])
@played(fly)
async def test_a_charge_that_cannot_be_true_is_no_news(flown: Flight, *, percent: int) -> None:
    await flown.say(battery(57))
    await flown.say(battery(percent))
    assert flown.vehicle.telemetry.batteries.charges_percent == {1: 57.0}
    assert len(flown.troubles("out-of-range")) == 1


E7, MM = 10**7, 1000
# The least and the most, and the number that stands for not known.
EDGES: dict[tuple[str, str], tuple[float, float, int | None]] = {
    ("GLOBAL_POSITION_INT", "lat"): (-90 * E7, 90 * E7, None),
    ("GLOBAL_POSITION_INT", "lon"): (-180 * E7, 180 * E7, None),
    ("GLOBAL_POSITION_INT", "alt"): (-1_000 * MM, 100_000 * MM, None),
    ("GLOBAL_POSITION_INT", "relative_alt"): (-10_000 * MM, 100_000 * MM, None),
    ("GPS_RAW_INT", "lat"): (-90 * E7, 90 * E7, None),
    ("HOME_POSITION", "altitude"): (-1_000 * MM, 100_000 * MM, None),
    ("POSITION_TARGET_GLOBAL_INT", "alt"): (-1_000.0, 100_000.0, None),
    ("ATTITUDE", "yaw"): (-2 * math.tau, 2 * math.tau, None),
    ("WIND", "speed"): (0.0, 150.0, None),
    ("WIND", "direction"): (-360.0, 360.0, None),
    ("WIND_COV", "wind_x"): (-150.0, 150.0, None),
    ("SYS_STATUS", "battery_remaining"): (-1, 100, -1),
    ("EXTENDED_SYS_STATE", "landed_state"): (0, 4, 0),
    ("SYSTEM_TIME", "time_unix_usec"): (0, 4_102_444_800_000_000, 0),  # the year 2100
}


@pytest.mark.parametrize(("kind", "name"), EDGES)
def test_a_number_is_possible_up_to_its_edge(kind: str, name: str) -> None:
    least, most, unknown = EDGES[kind, name]
    made = {each.msgname: each for each in mavlink.mavlink_map.values()}[kind]
    news = VehicleNewsFeed()
    beyond = (
        (least - 1, most + 1)
        if isinstance(most, int)
        else (math.nextafter(least, -math.inf), math.nextafter(most, math.inf))
    )
    for value in least, most, *beyond:
        message = made(*[0] * len(made.fieldnames))
        setattr(message, name, value)
        is_possible = value in (least, most)
        assert admits(message, ARDUCOPTER.ranges, news) == (is_possible or unknown is not None)
        assert getattr(message, name) == (value if is_possible or unknown is None else unknown)


@played(fly)
async def test_what_cannot_be_true_is_told_at_each_tenfold(flown: Flight) -> None:
    for _ in range(1_000):
        await flown.say(mavlink.MAVLink_wind_message(math.inf, 3.0, 0.0))
    told = flown.troubles("out-of-range")
    assert len(told) == 4
    assert "1000 times" in told[-1]


@played(fly)
async def test_numbers_that_stand_for_not_known_are_no_trouble(flown: Flight) -> None:
    await flown.say(
        battery(-1),
        position(lat=0, lon=0),
        home(latitude=0, longitude=0),
        mavlink.MAVLink_system_time_message(0, 1),
        mavlink.MAVLink_extended_sys_state_message(0, 0),
    )
    assert flown.vehicle.telemetry.home != GeoPosition(0.0, 0.0)
    assert not flown.troubles("out-of-range")


@played(fly, Px4Settings(HOME, armable_after_s=0.0))
async def test_a_px4_may_leave_the_altitude_of_its_target_out(flown: Flight) -> None:
    await flown.say(target(math.nan))
    assert not flown.troubles("out-of-range")


def test_a_defect_in_one_listener_keeps_a_message_from_no_other(caplog: pytest.LogCaptureFixture) -> None:
    async def flight(flown: Flight) -> None:
        await take_off(flown.autopilot)
        heard: list[str] = []

        def fails(message: Any) -> None:
            raise ZeroDivisionError(message.get_type())

        with (
            flown.vehicle.listening(fails),
            flown.vehicle.listening(lambda each: heard.append(each.get_type())),
        ):
            await flown.say(mavlink.MAVLink_wind_message(90.0, 3.0, 0.0), position())
            assert heard[-2:] == ["WIND", "GLOBAL_POSITION_INT"]
            assert flown.vehicle.telemetry.wind is not None
        assert any("WIND" in why and "ZeroDivisionError" in why for why in flown.troubles("defect"))
        assert flown.vehicle.linked
        await flown.autopilot.goto(FAR)

    with caplog.at_level(logging.ERROR):
        fly(flight)
    assert "Traceback" in caplog.text


@played(fly)
async def test_a_pilot_is_noticed_though_a_listener_fails_on_the_heartbeat(flown: Flight) -> None:
    await take_off(flown.autopilot)

    def fails(message: Any) -> None:
        raise ZeroDivisionError(message.get_type())

    with flown.vehicle.listening(fails):
        loiter = mavlink.MAVLink_heartbeat_message(2, 3, 81 | 128, mavlink.COPTER_MODE_LOITER, 4, 3)
        await flown.say(loiter)
        assert any(isinstance(each, Control) and each.owner is not Owner.PROGRAM for each in flown.news)
        with pytest.raises(AutopilotOverruled):
            await flown.autopilot.goto(FAR)


@pytest.mark.parametrize("kind", ["HEARTBEAT", "POSITION_TARGET_GLOBAL_INT"])
@played(fly)
async def test_a_vehicle_whose_owner_cannot_be_told_is_silent_and_gets_no_command(
    flown: Flight, *, kind: str
) -> None:
    await take_off(flown.autopilot)
    broken = True

    def fails(message: Any) -> None:
        if broken and message.get_type() == kind:
            raise ZeroDivisionError

    with flown.vehicle.listening(fails):
        leg = asyncio.create_task(flown.autopilot.goto(FAR))
        await asyncio.sleep(5.0)
        since_s = flown.sky.now_s
        await asyncio.sleep(20.0)
        assert not flown.sky.commands(since_s)
        assert any(isinstance(each, LinkLost) for each in flown.news)
        broken = False
        await leg  # a defect that passes is no end
    assert flown.vehicle.linked


@pytest.mark.parametrize("kind", ["HEARTBEAT", "POSITION_TARGET_GLOBAL_INT"])
@played(fly)
async def test_one_defect_in_telling_the_owner_is_no_silence(flown: Flight, *, kind: str) -> None:
    await take_off(flown.autopilot)
    failed: list[str] = []

    def fails(message: Any) -> None:
        if message.get_type() == kind and not failed:
            failed.append(kind)
            raise ZeroDivisionError

    with flown.vehicle.listening(fails):
        await flown.autopilot.goto(FAR)
    assert failed
    assert not any(isinstance(each, LinkLost | LinkRestored) for each in flown.news)


@played(fly)
async def test_a_vehicle_may_say_so_much_and_no_more(flown: Flight) -> None:
    for number in range(5_000):
        text = mavlink.MAVLink_statustext_message(4, f"words {number}".encode())
        await flown.say(text, home(latitude=LAT + 10_000 * (number % 2)))
    said = [each for each in flown.news if isinstance(each, (VehicleSaid, HomeMoved))]
    assert len(said) <= 150
    assert flown.troubles("flood")
    await take_off(flown.autopilot)  # and its words are not what a flight goes by


@pytest.mark.virtual
async def test_a_hundred_words_are_told_at_once_and_five_a_second_from_then_on() -> None:
    feed, told = VehicleNewsFeed(), list[VehicleNews]()
    feed.listen(told.append)
    words = VehicleSaid(severity=4, text="words")
    for wait_s, count in (0.0, 100), (2.0, 110), (60.0, 210):
        await asyncio.sleep(wait_s)
        for _ in range(150):
            feed.tell(words)
        assert told.count(words) == count


@pytest.mark.virtual
async def test_the_last_thousand_news_are_kept_until_there_is_a_listener() -> None:
    feed, told = VehicleNewsFeed(), list[VehicleNews]()
    for number in range(1_001):
        feed.tell(ArmingDelayed(reasons=(str(number),)))
    feed.listen(told.append)
    assert [news.reasons for news in told if isinstance(news, ArmingDelayed)] == [
        (str(number),) for number in range(1, 1_001)
    ]
    feed.tell(ArmingDelayed(reasons=()))
    assert len(told) == 1_001


def said_of(*texts: bytes, number: int = 0) -> list[str]:
    telemetry = VehicleTelemetry()
    for chunk, text in enumerate(texts):
        sent = mavlink.MAVLink_statustext_message(4, text, number, chunk % 256)
        wire = mavlink.MAVLink(None, 1, 1)
        telemetry.take(wire.parse_char(sent.pack(mavlink.MAVLink(None, 1, 1))), 1.0)
    return [text.text for _, text in telemetry.texts]


def test_control_characters_of_a_vehicle_become_escapes() -> None:
    assert said_of(b"\x1b[2Jall\r\n\x7f") == [r"\x1b[2Jall\r\n\x7f"]


def test_a_text_without_end_is_taken_in_parts() -> None:
    texts = said_of(*[b"x" * 50] * 255, number=7)
    assert [len(text) for text in texts] == [1000] * (255 // 20)


def test_texts_that_do_not_end_take_no_room() -> None:
    telemetry = VehicleTelemetry()
    for number in range(1, 65_536):
        chunk = mavlink.MAVLink_statustext_message(2, b"A" * 50, number, 7)
        wire = mavlink.MAVLink(None, 1, 1)
        telemetry.take(wire.parse_char(chunk.pack(mavlink.MAVLink(None, 1, 1))), 1.0)
    assert len(telemetry._chunks) == 1


@played(fly)
async def test_reports_that_nobody_asked_for_take_no_room(flown: Flight) -> None:
    known = len(flown.vehicle._streams._streams)
    for number in range(0, 65_536, 16):
        await flown.say(mavlink.MAVLink_message_interval_message(number, 1_000))
    assert len(flown.vehicle._streams._streams) <= known + 1
    numbers = [0] * 8
    for uid in range(1_000):
        await flown.say(
            mavlink.MAVLink_autopilot_version_message(0, 0, 0, 0, 0, numbers, numbers, numbers, 0, 0, uid)
        )
    assert len(flown.vehicle.identity.twins._hardware) <= 2


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_an_event_of_a_px4_with_no_number_is_words(value: float) -> None:
    telemetry = VehicleTelemetry()
    number = 32686809
    event = EventMessage(
        id_of_event=number,
        event_time_boot_ms=0,
        sequence=1,
        destination_component=0,
        destination_system=0,
        log_levels=0x44,
        arguments=px4_events()[number].packed(value),
    )
    PX4.take(telemetry, event, 1.0)
    assert "MPC_XY_CRUISE is set to" in telemetry.texts[-1][1].text


def test_a_defect_does_not_end_a_connection_over_tcp() -> None:
    """Where it did, each such message cost a second without the vehicle."""

    async def scenario() -> None:
        server = await serve_vehicle("tcp:127.0.0.1:0", COPTER)
        vehicle = MavlinkVehicle(server.address, DriverPatience(others_s=0.0), [ARDUCOPTER])
        try:
            heard: list[str] = []

            def fails(message: Any) -> None:
                heard.append(message.get_type())
                raise ZeroDivisionError

            with vehicle.listening(fails):
                await vehicle.found(within_s=10.0)
                opened_s = vehicle._link.opened_s
                async with asyncio.timeout(10.0):
                    while len(heard) < 50:
                        await vehicle._news.wait()
            assert vehicle._link.opened.is_set() and vehicle._link.opened_s == opened_s
        finally:
            await vehicle.close()
            await server.close()

    asyncio.run(scenario())


def test_an_error_of_the_vehicle_is_no_defect() -> None:
    """Errors that a verb raises reach who called it."""

    async def flight(flown: Flight) -> None:
        with pytest.raises(AutopilotError):
            await flown.autopilot.goto(FAR)
        assert not flown.troubles("defect")

    fly(flight)
