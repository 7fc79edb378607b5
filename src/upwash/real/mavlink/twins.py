"""Whether two vehicles send with the same ids: what one vehicle cannot report.

One vehicle gives none of this evidence, even if its messages are lost, repeated or late, or come by two links:

- Two serial numbers of hardware.
- Two clocks since boot. Each question for the time is answered between its sending and the answer's arrival, so two
  answers to one question that are farther apart are of two clocks. Without answers, a clock that goes back again and
  again, farther than any message is late.
- Two places. A vehicle's place follows from the time since boot. Reports in that order that lie beside the line
  between their neighbours, which agree, are another vehicle's.
- A mode, an arming or a home that changes to and fro for longer than any message is late.

Two sequences of numbers are no evidence: one vehicle numbers the messages of each of its ports by themselves.
"""

from __future__ import annotations

import bisect
from collections import OrderedDict, deque
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import LocalFrame, Position, Velocity, distance_m, part_way
from upwash.mavlink.packets import Message
from upwash.real.mavlink.gate import RANGES
from upwash.real.mavlink.telemetry import place_of_e7

_LATEST_S = 2.0  # no message comes later
_TIMES, _WITHIN_S = 3, 10.0  # one vehicle restarts less often
_QUESTIONS = 16  # whose answers may still come
_STAMPED_WITHIN_S = 0.05  # an autopilot's own inaccuracy
_SPEED_KNOWN_S = 1.0  # of a clock's stamps, until its speed is known
_LONGEST_BOOT_NS = 2**32 * 10**6  # 32 bits of milliseconds; a longer time counts from 1970
_REPORTS, _REPORTS_S = 256, 10.0  # of places that are compared
_SPAN_S = 1.0  # the longest time of three neighbours
_ODD_TIMES, _ODD_WITHIN_S = 5, 5.0  # a position filter resets less often
_PLACE_M = 0.5  # beside the line between two reports, by noise
_CURVE_M_S2 = 2.0  # by a turn or a gust
_LASTS_S, _PAUSE_S = 5.0, 1.5  # changes to and fro: longer than messages are late, faster than a pilot's


class Twins:
    """Looks for a second vehicle with the followed ids; `evidence` is what shows it, "" without any."""

    def __init__(self) -> None:
        self.evidence = ""
        self._clocks = _Clocks()
        self._answers = _Answers(self._clocks)
        self._places = _Places()
        self._hardware: set[tuple[int, bytes]] = set()
        self._states, self._homes = _ToAndFro(), _ToAndFro()

    def question(self, now_s: float) -> Message:
        """A question for the time, which every vehicle answers; it changes nothing."""
        return self._answers.question(now_s)

    def take(self, message: Message, now_s: float) -> None:
        """Take in a message with the followed ids, copies included."""
        if not self.evidence:
            self.evidence = self._shown_by(message, now_s)

    def _shown_by(self, message: Message, now_s: float) -> str:
        kind = message.get_type()
        boot_ms = getattr(message, "time_boot_ms", None)
        if boot_ms is not None and self._clocks.goes_back(message.get_msgId(), boot_ms / 1e3, now_s):
            return "two clocks since boot"
        match kind:
            case "GLOBAL_POSITION_INT":
                return self._places.shown_by(message, now_s)
            case "TIMESYNC":
                return self._answers.shown_by(message, now_s)
            case "AUTOPILOT_VERSION":
                self._hardware.add((message.uid, bytes(message.uid2)))
                return "two serial numbers of hardware" if len(self._hardware) > 1 else ""
            case "HEARTBEAT":
                armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
                alternates = self._states.take((message.custom_mode, armed), now_s)
                return "heartbeats of two states in turns" if alternates else ""
            case "HOME_POSITION":
                alternates = self._homes.take((message.latitude, message.longitude), now_s)
                return "two homes in turns" if alternates else ""
        return ""


class _Often:
    """Whether an event happened `times` times within some seconds."""

    def __init__(self, times: int, within_s: float) -> None:
        self._happened_s: deque[float] = deque(maxlen=times)
        self._within_s = within_s

    def happens(self, now_s: float) -> bool:
        happened_s = self._happened_s
        happened_s.append(now_s)
        return len(happened_s) == happened_s.maxlen and now_s - happened_s[0] <= self._within_s


class _Clocks:
    """The times since boot in each kind of message."""

    def __init__(self) -> None:
        self._first: dict[int, tuple[float, float]] = {}  # by message number: time since boot, and arrival
        self._last_s: dict[int, float] = {}  # the last time since boot, by message number
        self._went_back: dict[int, _Often] = {}  # by message number: a restart shows once in each

    def speed(self, number: int, boot_s: float, now_s: float) -> float:
        """How fast the clock is, at least 1: a simulated vehicle's may be fast."""
        first_s, heard_s = self._first.setdefault(number, (boot_s, now_s))
        return max(1.0, (boot_s - first_s) / max(now_s - heard_s, _SPEED_KNOWN_S))

    def knows_speed(self, number: int, now_s: float) -> bool:
        """Whether that kind of message has come for long enough."""
        return number in self._first and now_s - self._first[number][1] >= _SPEED_KNOWN_S

    def goes_back(self, number: int, boot_s: float, now_s: float) -> bool:
        """Take in a time since boot; whether it has gone back again and again by more than a message is late."""
        before_s = self._last_s.get(number, boot_s)
        self._last_s[number] = boot_s
        if boot_s >= before_s - _LATEST_S * self.speed(number, before_s, now_s):
            return False
        return self._went_back.setdefault(number, _Often(_TIMES, _WITHIN_S)).happens(now_s)


class _Answers:
    """The answers to questions for the time."""

    def __init__(self, clocks: _Clocks) -> None:
        self._clocks = clocks
        self._asked_s: OrderedDict[int, float] = OrderedDict()  # by a question's own time
        self._stamped_s: dict[int, float] = {}  # by its first answer
        self._apart = _Often(_TIMES, _WITHIN_S)

    def question(self, now_s: float) -> Message:
        own_ns = round(now_s * 1e9)
        self._asked_s[own_ns] = now_s
        if len(self._asked_s) > _QUESTIONS:
            forgotten, _ = self._asked_s.popitem(last=False)
            self._stamped_s.pop(forgotten, None)
        return mavlink.MAVLink_timesync_message(0, own_ns)

    def shown_by(self, message: Message, now_s: float) -> str:
        asked_s = self._asked_s.get(message.ts1)
        if asked_s is None or not 0 < message.tc1 < _LONGEST_BOOT_NS:
            return ""
        number, stamped_s = message.get_msgId(), message.tc1 / 1e9
        apart_s = abs(stamped_s - self._stamped_s.setdefault(message.ts1, stamped_s))
        speed = self._clocks.speed(number, stamped_s, now_s)
        if apart_s <= _STAMPED_WITHIN_S + speed * (now_s - asked_s):
            return ""
        if not self._clocks.knows_speed(number, now_s) or not self._apart.happens(now_s):
            return ""
        return f"two clocks since boot, {apart_s:.1f} s apart"


class _PlaceReport(NamedTuple):
    boot_s: float
    place: Position
    velocity: Velocity

    def after(self, passed_s: float) -> Position:
        """Where it goes in that time, at its velocity; altitudes above the sea may be negative."""
        east_m, north_m, up_m = (
            self.velocity.east_m_s * passed_s,
            self.velocity.north_m_s * passed_s,
            self.velocity.up_m_s * passed_s,
        )
        here = self.place
        return Position(here.east_m + east_m, here.north_m + north_m, here.altitude_m + up_m)


class _Places:
    """The reported places in the order of the time since boot."""

    def __init__(self) -> None:
        self._frame: LocalFrame | None = None
        self._reports: list[_PlaceReport] = []  # by time since boot
        self._arrived: deque[tuple[float, _PlaceReport]] = deque()
        self._odd = _Often(_ODD_TIMES, _ODD_WITHIN_S)

    def shown_by(self, message: Message, now_s: float) -> str:
        report = self._read(message)
        if report is None:
            return ""
        reports = self._reports
        at = bisect.bisect_right(reports, report.boot_s, key=lambda each: each.boot_s)
        reports.insert(at, report)
        self._arrived.append((now_s, report))
        near = reports[max(0, at - 2) : at + 3]
        apart_m = max((_beside_m(*near[i : i + 3]) for i in range(len(near) - 2)), default=0.0)
        while len(reports) > _REPORTS or self._arrived[0][0] < now_s - _REPORTS_S:
            reports.remove(self._arrived.popleft()[1])
        return f"two places, {apart_m:.1f} m apart" if apart_m and self._odd.happens(now_s) else ""

    def _read(self, message: Message) -> _PlaceReport | None:
        spans = RANGES["GLOBAL_POSITION_INT"]
        if not any((message.lat, message.lon)) or not all(
            span.least <= getattr(message, name) <= span.most for name, span in spans.items()
        ):
            return None
        geo = place_of_e7(message.lat, message.lon, message.alt / 1e3)
        self._frame = self._frame or LocalFrame(geo)
        velocity = Velocity(message.vy / 100, message.vx / 100, -message.vz / 100)
        return _PlaceReport(message.time_boot_ms / 1e3, self._frame.position(geo), velocity)


def _beside_m(before: _PlaceReport, between: _PlaceReport, after: _PlaceReport) -> float:
    """How far the middle report lies beside the line of the others; 0 if one vehicle can have made all three."""
    span_s = after.boot_s - before.boot_s
    share = (between.boot_s - before.boot_s) / span_s if span_s else 0.0
    line = part_way(before.place, after.place, share)
    allowed_m = _PLACE_M + _CURVE_M_S2 * span_s**2
    agree = span_s <= _SPAN_S and distance_m(before.after(span_s), after.place) <= allowed_m
    beside_m = distance_m(between.place, line)
    return beside_m if agree and beside_m > allowed_m else 0.0


class _ToAndFro:
    """A value that goes back to what it was before the last change, again and again."""

    def __init__(self) -> None:
        self._last: object = None
        self._before: object = None
        self._since_s = self._returned_s = float("-inf")

    def take(self, value: object, now_s: float) -> bool:
        """Take in the value; whether it has gone to and fro for long enough."""
        if value == self._last:
            return False
        returns = value == self._before
        self._before, self._last = self._last, value
        if not returns:
            return False
        if now_s - self._returned_s > _PAUSE_S:
            self._since_s = now_s
        self._returned_s = now_s
        return now_s - self._since_s >= _LASTS_S
