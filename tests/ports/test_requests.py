"""Which reports are requested of a vehicle and when, second by second: of each cause of a low rate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.eventlog.schema import LinkTrouble
from upwash.ports import VehicleNews
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.news import VehicleNewsFeed
from upwash.real.mavlink.streams import Streams

SET, GET = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_GET_MESSAGE_INTERVAL
ATTITUDE, POSITION = mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
TIME, WIND, GPS, LOCAL = (
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
    mavlink.MAVLINK_MSG_ID_WIND,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
)
NEEDED = {ATTITUDE: 8.0, POSITION: 4.0, TIME: 1.0}
MANY = {**NEEDED, GPS: 1.0, LOCAL: 2.0, WIND: 1.0}
TICKS = 16  # in a second: a fraction that floats hold exactly


def report(number: int) -> Any:
    kind = mavlink.mavlink_map[number]
    return kind(*[0] * len(kind.fieldnames))


class Vehicle:
    """A vehicle with those rates, whatever is requested; answers to questions have the interval that it `tells`."""

    def __init__(
        self,
        needed: Mapping[int, float] = NEEDED,
        *,
        at_times: Iterable[int] = (),
        received_share: float = 1.0,
    ) -> None:
        self.now_s = 0.0
        self.rates = dict(needed)
        self.tells: dict[int, int] | None = {}  # microseconds; None: it acknowledges no question
        self.asked: list[tuple[float, int, int, float]] = []  # when, command, report, microseconds
        self.told: list[VehicleNews] = []
        self.linked = True
        self.received_share = received_share
        news = VehicleNewsFeed()
        news.listen(self.told.append)
        self.firmware = replace(ARDUCOPTER, streams_hz=needed, sent_at_times=frozenset(at_times))
        self.streams = Streams(self._ask, quiet_after_s=2.5, news=news)

    def begin(self) -> None:
        self.streams.begin(self.firmware, self.now_s)

    def look(self) -> None:
        self.streams.look(self.now_s, linked=self.linked, received_share=self.received_share)

    def live(self, for_s: int) -> None:
        """Its reports come, and the driver looks at them each second."""
        for _ in range(for_s):
            for _ in range(TICKS):
                self.now_s += 1 / TICKS
                for number, rate_hz in self.rates.items():
                    if self.now_s * rate_hz % 1 == 0 and rate_hz:
                        self.hear(report(number))
            self.look()

    def hear(self, message: Any) -> None:
        self.streams.heard(message, self.now_s)

    def _ask(self, command: int, number: int, interval_us: float = 0.0) -> None:
        self.asked.append((self.now_s, command, number, interval_us))
        if command == GET and self.tells is not None:
            self.hear(mavlink.MAVLink_command_ack_message(GET, 0, 0, 0, 1, 191))
            if number in self.tells:
                self.hear(mavlink.MAVLink_message_interval_message(number, self.tells[number]))

    def times_s(self, command: int = SET, number: int = ATTITUDE) -> list[float]:
        return [at_s for at_s, asked, of, _ in self.asked if (asked, of) == (command, number)]

    def requests(self, since_s: float = 0.0) -> dict[int, float]:
        """The last requested rate of each report."""
        return {
            of: 1e6 / interval_us
            for at_s, asked, of, interval_us in self.asked
            if asked == SET and at_s >= since_s
        }

    @property
    def troubles(self) -> list[tuple[str, str]]:
        return [(news.about, news.why) for news in self.told if isinstance(news, LinkTrouble)]


def settled(needed: Mapping[int, float] = NEEDED, **named: Any) -> Vehicle:
    """A vehicle whose reports have come at the right rates for ten seconds."""
    vehicle = Vehicle(needed, **named)
    vehicle.begin()
    vehicle.live(10)
    assert vehicle.times_s(number=next(iter(needed))) == [0.0]
    vehicle.asked.clear()
    return vehicle


def test_all_reports_are_requested_of_a_new_vehicle_and_four_a_second_after_a_silence() -> None:
    vehicle = Vehicle(MANY)
    vehicle.begin()
    assert vehicle.asked == [(0.0, SET, number, 1e6 / needed_hz) for number, needed_hz in MANY.items()]
    vehicle.live(5)
    assert len(vehicle.asked) == len(MANY)
    vehicle.now_s, vehicle.linked = 60.0, False
    vehicle.asked.clear()
    vehicle.look()
    assert vehicle.asked == []
    vehicle.linked = True
    vehicle.begin()
    assert [number for _, _, number, _ in vehicle.asked] == list(MANY)[:4]
    vehicle.live(1)
    assert [(at_s, number) for at_s, _, number, _ in vehicle.asked[4:]] == [
        (61.0, number) for number in list(MANY)[4:]
    ]
    vehicle.live(9)
    assert len(vehicle.asked) == len(MANY)


def test_a_missing_report_is_requested_for_ten_seconds_and_twice_a_minute_from_then_on() -> None:
    vehicle = settled()
    vehicle.rates[TIME] = 0.0
    vehicle.live(100)
    first_s = [float(second) for second in range(13, 23)]
    assert vehicle.times_s(number=TIME) == [*first_s, 43.0, 73.0, 103.0]
    assert vehicle.times_s(number=ATTITUDE) == []
    vehicle.rates[TIME] = 1.0
    vehicle.live(5)
    vehicle.rates[TIME] = 0.0
    vehicle.asked.clear()
    vehicle.live(14)
    assert vehicle.times_s(number=TIME) == [float(second) for second in range(118, 128)]
    assert vehicle.troubles == []


def test_a_report_is_missing_when_its_silence_is_longer_than_that_of_a_lost_link() -> None:
    vehicle = settled({TIME: 1.0})
    vehicle.now_s = 12.5
    vehicle.look()
    assert vehicle.asked == []
    vehicle.now_s += 1 / TICKS
    vehicle.look()
    assert vehicle.times_s(number=TIME) == [vehicle.now_s]


def test_no_more_than_four_missing_reports_are_requested_in_a_second() -> None:
    vehicle = Vehicle(MANY)
    vehicle.rates.clear()
    vehicle.begin()
    vehicle.live(20)
    first_s, then_s = [float(second) for second in range(1, 11)], [float(second) for second in range(11, 21)]
    for number in list(MANY)[:4]:
        assert vehicle.times_s(number=number) == [0.0, *first_s]
    for number in list(MANY)[4:]:
        assert vehicle.times_s(number=number) == [0.0, *then_s]


def test_another_program_that_lowers_a_rate_is_asked_against_ever_more_rarely_and_told_of() -> None:
    vehicle = settled()
    vehicle.rates[ATTITUDE], vehicle.tells = 1.0, {ATTITUDE: 1_000_000}
    vehicle.live(300)
    again_s = [11.0, 15.0, 22.0, 35.0, 60.0, 109.0, 170.0, 231.0, 292.0]
    for number in NEEDED:  # all reports: that program may have lowered all
        assert vehicle.times_s(number=number) == again_s
    assert vehicle.times_s(GET) == [at_s - 1.0 for at_s in again_s[1:]]
    assert vehicle.requests() == NEEDED
    assert vehicle.troubles == [
        (
            "rates",
            "another program on the link, such as a ground station, keeps ATTITUDE at 1 Hz, though 8 Hz were "
            "asked for 3 times",
        )
    ]


@pytest.mark.parametrize(("right_for_s", "then"), [(102, GET), (103, SET)])
def test_a_vehicle_whose_rates_were_right_for_two_minutes_is_asked_at_once_again(
    right_for_s: int, then: int
) -> None:
    vehicle = settled()
    vehicle.rates[ATTITUDE], vehicle.tells = 1.0, {ATTITUDE: 1_000_000}
    vehicle.live(300)
    assert vehicle.times_s()[-1] == 292.0
    vehicle.rates[ATTITUDE], vehicle.asked = 8.0, []
    vehicle.live(right_for_s)
    assert vehicle.asked == []
    vehicle.rates[ATTITUDE] = 1.0
    vehicle.live(1)
    assert {command for _, command, _, _ in vehicle.asked} == {then}


def test_a_low_rate_is_told_after_the_fourth_request() -> None:
    vehicle = settled()
    vehicle.rates[ATTITUDE], vehicle.tells = 1.0, {ATTITUDE: 1_000_000}
    vehicle.live(24)
    assert (len(vehicle.times_s()), vehicle.troubles) == (3, [])
    vehicle.live(1)
    assert (len(vehicle.times_s()), len(vehicle.troubles)) == (4, 1)


@pytest.mark.parametrize(
    ("tells", "said"),
    [
        ({ATTITUDE: 1_000_000}, "the vehicle, or another program on the link, keeps ATTITUDE at 1 Hz"),
        ({ATTITUDE: 0}, "the vehicle, or another program on the link, keeps ATTITUDE at 0 Hz"),
        ({ATTITUDE: -1}, "the vehicle, or another program on the link, keeps ATTITUDE at 0 Hz"),
        ({}, "ATTITUDE comes too rarely, though 8 Hz were asked for 3 times; the vehicle does not say why"),
    ],
)
def test_the_reason_of_a_low_rate_is_told_as_the_vehicle_gives_it(tells: dict[int, int], said: str) -> None:
    vehicle = Vehicle()
    vehicle.rates[ATTITUDE], vehicle.tells = 1.0, tells
    vehicle.begin()
    vehicle.live(60)
    ((about, why),) = vehicle.troubles
    assert about == "rates"
    assert why.startswith(said)


def test_a_vehicle_that_acknowledges_the_question_has_two_seconds_for_the_interval() -> None:
    vehicle = settled()
    vehicle.rates[ATTITUDE], vehicle.tells = 1.0, {}
    vehicle.live(30)
    assert vehicle.times_s(GET) == [14.0, 22.0, 36.0]
    assert vehicle.times_s() == [11.0, 16.0, 24.0, 38.0]


QUARTER = {ATTITUDE: 2.0, POSITION: 1.0, TIME: 0.5}  # half a report a second at least


@pytest.mark.parametrize(
    ("tells", "half_s", "quarter_s"),
    [({ATTITUDE: 125_000}, 22.0, 33.0), ({ATTITUDE: 156_250}, 22.0, 33.0), (None, 24.0, 37.0)],
    ids=["as requested", "rounded", "no answer"],
)
def test_a_link_that_carries_less_is_asked_for_less_down_to_a_quarter(
    tells: dict[int, int] | None, half_s: float, quarter_s: float
) -> None:
    vehicle = settled()
    vehicle.rates[ATTITUDE], vehicle.tells = 0.5, tells
    vehicle.live(300)
    assert vehicle.times_s()[:3] == [11.0, half_s, quarter_s]
    assert vehicle.requests(11.0) == QUARTER
    assert {at_s: hz for at_s, _, of, us in vehicle.asked if us and of == POSITION for hz in [1e6 / us]} == {
        11.0: 4.0,
        half_s: 2.0,
        quarter_s: 1.0,
    }
    assert vehicle.troubles == [
        (
            "capacity",
            "the link does not carry all reports: ATTITUDE comes too rarely, though no other program set its rate "
            "below 8 Hz; all reports are asked for less often from now on",
        )
    ]


def test_a_link_that_carries_less_is_tried_with_more_after_two_minutes_and_then_after_four() -> None:
    vehicle = settled()
    vehicle.rates[ATTITUDE], vehicle.tells = 1.0, {ATTITUDE: 125_000}
    vehicle.live(1000)
    more_s = [33.0 + 121.0, 168.0 + 241.0, 423.0 + 481.0]
    tries_s = [at_s + later_s for at_s in more_s for later_s in (0.0, 3.0, 14.0)]  # in vain
    assert vehicle.times_s() == [11.0, 22.0, 33.0, *tries_s]
    assert vehicle.requests(900.0) == QUARTER


def test_a_link_that_carries_all_again_has_all_rates_back_after_six_minutes() -> None:
    vehicle = settled()
    vehicle.rates[ATTITUDE], vehicle.tells = 1.0, {ATTITUDE: 125_000}
    vehicle.live(30)
    vehicle.rates[ATTITUDE], vehicle.asked = 8.0, []
    vehicle.live(1000)
    half_s, all_s = 154.0, 154.0 + 241.0
    assert vehicle.times_s() == [half_s, all_s]
    assert vehicle.requests() == NEEDED


# --- the measurement ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("needed_hz", "received_share", "enough"),
    [(8.0, 1.0, 4), (8.0, 0.75, 3), (16.0, 0.75, 6), (16.0, 0.5, 2)],
)
def test_half_a_rate_is_enough_and_less_where_the_radio_loses_reports(
    needed_hz: float, received_share: float, enough: int
) -> None:
    for came in enough, enough - 1:
        vehicle = settled({ATTITUDE: needed_hz}, received_share=received_share)
        for number in range(came):
            vehicle.now_s = 10.0 + (number + 1) / TICKS
            vehicle.hear(report(ATTITUDE))
        vehicle.now_s = 11.0
        vehicle.look()
        assert bool(vehicle.asked) == (came < enough)


def test_a_slow_report_is_measured_over_eight_of_its_periods() -> None:
    vehicle = settled({TIME: 1.0})
    vehicle.rates[TIME] = 0.5
    vehicle.live(60)
    assert vehicle.asked == []
    vehicle.rates[TIME] = 0.0
    for second in range(60):
        vehicle.live(1)
        if second % 5 in (0, 2):  # two in five seconds
            vehicle.hear(report(TIME))
    assert vehicle.asked


def test_a_report_that_the_vehicle_sends_at_times_is_not_measured() -> None:
    vehicle = settled(NEEDED, at_times=[ATTITUDE])
    vehicle.rates[ATTITUDE] = 0.5
    vehicle.live(60)
    assert vehicle.asked == []


def test_a_request_has_half_a_second_to_take_effect() -> None:
    vehicle = Vehicle({ATTITUDE: 8.0})
    vehicle.begin()
    vehicle.asked.clear()
    for at_s, asks in (0.25, False), (1.25, False), (1.5 - 1 / TICKS, False), (1.5, True):
        vehicle.now_s = at_s
        if at_s % 1 == 0.25:
            vehicle.hear(report(ATTITUDE))
        vehicle.look()
        assert bool(vehicle.asked) == asks


@pytest.mark.parametrize(("pause_s", "asks"), [(2.5, True), (2.5 + 1 / TICKS, False)])
def test_after_a_pause_a_report_is_measured_anew(pause_s: float, *, asks: bool) -> None:
    vehicle = settled({ATTITUDE: 8.0})
    vehicle.now_s += pause_s
    vehicle.hear(report(ATTITUDE))
    vehicle.look()
    assert bool(vehicle.asked) == asks
    vehicle.now_s += 1 - 1 / TICKS
    vehicle.look()
    assert bool(vehicle.asked) == asks
    vehicle.now_s += 1 / TICKS
    vehicle.look()
    assert vehicle.asked
