"""The reports of a vehicle: requests for them, their measured rates, and what to do about a low rate.

A rate that is too low has one of two causes, and the vehicle's MESSAGE_INTERVAL tells the causes apart. If the
interval differs from the request, another program or the vehicle changed it: the driver repeats the request, ever
more rarely. If the interval agrees with the request, or no answer gets through, the link carries less: the driver
requests less. Reports that the radio lost count as sent.

The rates of some reports do not follow the request. These rates only show whether another program lowered them. While
an ArduPilot serves parameters, a mission or files, it sends all reports more rarely: no rate is judged then.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import Message
from upwash.real.mavlink.news import VehicleNewsFeed
from upwash.real.mavlink.telemetry import FirmwareProfile

_ASKED_AT_ONCE = 10  # requests for a missing report, one a second
_ASKED_EACH = 30  # seconds between two requests from then on
_ASKED_TOGETHER = 4  # of the missing reports, so that requests do not fill a narrow link
_TOO_RARE = 0.5  # of the rate that is needed
_CHANCE = 3.0  # standard deviations
_MEASURED_S, _MEASURED_REPORTS = 1.0, 8.0  # at least; whichever lasts longer
_SETTLING_S = 0.5  # until a request has an effect
_ANSWERED_S = 2.0  # after which no answer will come
_AGAIN_S, _AGAIN_AT_MOST_S = 3.0, 60.0
_FORGIVEN_S = 120.0  # at the right rates; then the next request is made at once again
_TOLD_AFTER = 3  # requests
_AS_ASKED = 0.8  # of a rate, which the vehicle may round
_CONFIRMED_TIMES = 2  # until the link is believed to carry no more
_LEAST_SHARE, _LEAST_HZ = 0.25, 0.5
_TRANSFERS = ("PARAM_VALUE", "MISSION_REQUEST", "MISSION_REQUEST_INT", "FILE_TRANSFER_PROTOCOL")
_TRANSFER_S, _TRANSFER_MESSAGES = 1.0, 5  # in that time; a question for one parameter is no transfer
_KEPT = 256  # times of arrival: some seconds of the fastest report


@dataclass(slots=True)
class _Stream:
    """The arrivals of one kind of report."""

    came_s: deque[float] = field(default_factory=lambda: deque(maxlen=_KEPT))
    began_s: float = math.inf  # after a pause
    asked_times: int = 0  # since it last came
    set_hz: float | None = None  # as the vehicle last said
    was_right: bool = False  # at any time

    @property
    def heard_s(self) -> float:
        return self.came_s[-1] if self.came_s else -math.inf

    def came_since(self, since_s: float) -> int:
        return sum(came_s > since_s for came_s in self.came_s)


class Streams:
    """Requests the reports that the driver needs: at the start, and again after a rate fell or the link was silent.

    `ask(number, *parameters)` sends a MAV_CMD that only asks.
    """

    def __init__(self, ask: Callable[..., None], *, quiet_after_s: float, news: VehicleNewsFeed) -> None:
        self._ask = ask
        self._news = news
        self._quiet_after_s = quiet_after_s
        self._firmware: FirmwareProfile  # this and the next five: from `begin` on
        self._times: int  # repetitions of the requests
        self._confirmed_times: int  # answers as requested
        self._questioned: tuple[int, float] | None  # whose MESSAGE_INTERVAL was requested, and when
        self._is_answered: bool  # whether it acknowledged that question
        self._next_s: float
        self._streams: defaultdict[int, _Stream] = defaultdict(_Stream)
        self.share = 1.0  # of the rates that are needed, as much as the link carries
        self._forgiven_s = _FORGIVEN_S
        self._due: list[int] = []  # the reports whose request was not sent yet
        self._asked_s = -math.inf  # when a report was last asked for with all others
        self._transferred_s = -math.inf  # when it last served parameters, a mission or files

    def heard(self, message: Message, now_s: float) -> None:
        """Note that a message has come."""
        stream = self._streams[message.get_msgId()]
        if now_s - stream.heard_s > self._quiet_after_s:
            stream.began_s = now_s
        stream.came_s.append(now_s)
        if message.get_type() in _TRANSFERS and stream.came_since(now_s - _TRANSFER_S) >= _TRANSFER_MESSAGES:
            self._transferred_s = now_s
        if message.get_type() == "COMMAND_ACK" and message.command == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
            self._is_answered = True
        elif message.get_type() == "MESSAGE_INTERVAL" and (asked := self._streams.get(message.message_id)):
            interval_us = message.interval_us
            asked.set_hz = 1e6 / interval_us if interval_us > 0 else 0.0

    def heard_s(self, number: int) -> float:
        """When a message of that number last came; minus infinity if none did."""
        return self._streams[number].heard_s

    def begin(self, firmware: FirmwareProfile, now_s: float) -> None:
        """Request all reports: at once from a vehicle that was just found, a few at a time after a silence."""
        self._firmware = firmware
        together = len(firmware.streams_hz) if math.isinf(self._asked_s) else _ASKED_TOGETHER
        self._times, self._confirmed_times, self._questioned, self._next_s = 0, 0, None, -math.inf
        self._ask_for_all(now_s, together=together)

    def look(self, now_s: float, *, linked: bool, received_share: float) -> None:
        """Ask for reports that are missing or too rare; `received_share` of the vehicle's messages arrive."""
        if not linked:  # what it does not hear fills a narrow link
            return
        if self._due:
            self._ask_for_due(now_s, together=_ASKED_TOGETHER)
            return
        self._ask_for_missing(now_s)
        rare = self._too_rare(now_s, received_share)
        if rare is not None:
            self._ask_again(rare, now_s)
        elif now_s - self._asked_s > self._forgiven_s:
            self._times = self._confirmed_times = 0
            if self.share < 1.0:  # a link may carry more by now: ever more rarely
                self.share, self._forgiven_s = 2 * self.share, 2 * self._forgiven_s
                self._ask_for_all(now_s)

    def _wanted_hz(self, number: int) -> float:
        needed_hz = self._firmware.streams_hz[number]
        return max(needed_hz * self.share, min(needed_hz, _LEAST_HZ))

    def _ask_for_all(self, now_s: float, *, together: int = _ASKED_TOGETHER) -> None:
        self._due = list(self._firmware.streams_hz)
        self._ask_for_due(now_s, together=together)

    def _ask_for_due(self, now_s: float, *, together: int) -> None:
        self._asked_s = now_s
        for number in self._due[:together]:
            self._ask_for(number)
        del self._due[:together]

    def _ask_for(self, number: int) -> None:
        self._ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / self._wanted_hz(number))

    def _ask_for_missing(self, now_s: float) -> None:
        asked = 0
        for number in self._firmware.streams_hz:
            stream = self._streams[number]
            if stream.heard_s >= now_s - self._quiet_after_s:
                stream.asked_times = 0
                continue
            if asked == _ASKED_TOGETHER:
                return
            if stream.asked_times < _ASKED_AT_ONCE or stream.asked_times % _ASKED_EACH == 0:
                self._ask_for(number)
                asked += 1
            stream.asked_times += 1

    def _too_rare(self, now_s: float, received_share: float) -> int | None:
        """The number of the first report that comes too rarely; None if all come often enough."""
        not_before_s = max(self._asked_s + _SETTLING_S, self._transferred_s + _TRANSFER_S)
        for number, expected_hz in self._expected_hz().items():
            stream = self._streams[number]
            if now_s - stream.heard_s > self._quiet_after_s:
                continue
            measured_s = max(_MEASURED_S, _MEASURED_REPORTS / expected_hz)
            since_s = now_s - measured_s
            if since_s < max(stream.began_s, not_before_s):
                continue
            if stream.came_since(since_s) < _fewest(expected_hz * measured_s, received_share):
                return number
            stream.was_right = True
        return None

    def _expected_hz(self) -> dict[int, float]:
        """The rates that a good link brings, and after them those of reports that come anyway."""
        firmware = self._firmware
        asked = {number: self._wanted_hz(number) for number in firmware.streams_hz}
        of_link = {number: hz for number, hz in asked.items() if number not in firmware.sent_at_times}
        return of_link | {number: min(asked[number], hz) for number, hz in firmware.sent_anyway_hz.items()}

    def _ask_again(self, rare: int, now_s: float) -> None:
        """Ask again for a rare report: at once the first time, later after a question for its present interval."""
        if now_s < self._next_s:
            return
        if self._times and self._questioned is None:
            self._questioned, self._is_answered, self._streams[rare].set_hz = (rare, now_s), False, None
            self._ask(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, rare)
            return
        number, questioned_s = self._questioned or (rare, -math.inf)
        set_hz, wanted_hz = self._streams[number].set_hz, self._wanted_hz(number)
        if set_hz is None and now_s - questioned_s < _ANSWERED_S:
            return
        self._questioned = None
        self._next_s = now_s + min(_AGAIN_S * 2**self._times, _AGAIN_AT_MOST_S)
        self._times += 1
        is_as_asked = set_hz is not None and set_hz >= _AS_ASKED * wanted_hz
        if self._times > 1 and (is_as_asked or not self._is_answered):
            self._settle(number, now_s)
            return
        self._ask_for_all(now_s)
        if self._times > _TOLD_AFTER:
            self._news.once("rates", _rates_problem(number, self._streams[number], wanted_hz))

    def _settle(self, number: int, now_s: float) -> None:
        """Request fewer reports, as the link carries fewer than the vehicle was set to send."""
        if number in self._firmware.sent_at_times:
            return
        self._confirmed_times += 1
        if self._confirmed_times < _CONFIRMED_TIMES or self.share <= _LEAST_SHARE:
            return
        self.share, self._confirmed_times, self._times = self.share / 2, 0, 1
        self._next_s = -math.inf
        self._ask_for_all(now_s)
        self._news.once(
            "capacity",
            f"the link does not carry all reports: {_named(number)} comes too rarely, though no other program set "
            f"its rate below {self._firmware.streams_hz[number]:g} Hz; all reports are asked for less often from now "
            "on",
        )


def _fewest(wanted: float, received_share: float) -> float:
    """The least number of reports that counts as enough, with an allowance for chance on a lossy link."""
    expected = wanted * received_share
    return min(_TOO_RARE * expected, expected - _CHANCE * math.sqrt(expected * (1 - received_share)))


def _rates_problem(number: int, stream: _Stream, wanted_hz: float) -> str:
    name, asked = _named(number), f"{wanted_hz:g} Hz were asked for {_TOLD_AFTER} times"
    if stream.set_hz is None:
        return f"{name} comes too rarely, though {asked}; the vehicle does not say why"
    who = "another program on the link, such as a ground station, keeps"
    if not stream.was_right:
        who = "the vehicle, or another program on the link, keeps"
    return f"{who} {name} at {stream.set_hz:.2g} Hz, though {asked}"


def _named(number: int) -> str:
    kind = mavlink.mavlink_map.get(number)
    return str(kind.msgname) if kind else f"message {number}"
