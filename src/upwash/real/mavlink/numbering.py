"""The order and the clock of a vehicle's messages: sequence numbers, and times since boot.

A vehicle numbers its messages, so a message that arrives out of order is known by its number. Not all numbers are the
vehicle's: bridges pack each message with number 0, count each kind of message by itself, or merge two ports of one
vehicle. If more distinct messages come than the numbers count, or the numbers leap about, they are ignored; the time
since boot, which some messages contain, gives the order. `twins` decides whether two vehicles send the messages.
"""

from __future__ import annotations

import math
from collections import OrderedDict

from upwash.mavlink.packets import Message

_LATE_BY = 64  # messages, about a second: an older number comes from a restarted vehicle
_LATE_BY_MS = 2000  # the same by the time since boot
_SMALL_STEP = 8  # a larger one is a gap of lost messages if a later number follows, else a stranger's number
_JUDGED_EACH = 32  # distinct messages
_LEAST_STEP, _LARGEST_STEP = 0.75, 16.0  # on average: some come late, and 15 of 16 may be lost
_REMEMBERED = 64  # messages, to recognize copies
_AS_GOOD_LATE = ("STATUSTEXT", "BATTERY_STATUS")  # a text is no state, and a charge changes slowly
_COPIED_WITHIN_S = 0.5  # a later repetition is the vehicle's, not the link's

_OUT_OF_ORDER_S = 1.0  # a time that is older by no more arrived out of order
_CONFIRMED_AFTER_S = 1.0  # in this time a second vehicle, or the true clock after a lie, is heard
_PAUSE_S = 0.5  # no message is later, and no second vehicle is silent for longer
_AHEAD_S, _FASTEST = 5.0, 20.0  # a simulated vehicle's clock may be faster than this computer's


class Numbering:
    """The sequence numbers of one vehicle's messages."""

    def __init__(self) -> None:
        self.counts_up = True  # whether the numbers tell the order
        self.wrong_times = 0  # judgements in a row that they do not
        self.received_share = 1.0  # of the messages that the vehicle sent, at the last judgement
        self._newest: int | None = None
        self._newest_s = -math.inf
        self._leapt_to: int | None = None  # a number far ahead, which none has followed yet
        self._distinct = self._counted = 0
        self._seen: OrderedDict[tuple[int, int, int], float] = OrderedDict()
        self._boot_ms: dict[int, int] = {}  # the latest time since boot, by message number

    def is_news(self, message: Message, now_s: float, *, linked: bool) -> bool:
        """Whether the message is no copy and did not arrive late; after a silence every message is news."""
        if not linked:
            self._newest = self._leapt_to = None
            self._distinct = self._counted = 0
            self._boot_ms.clear()
        is_copy = self._is_copy(message, now_s)
        is_ahead = self._is_ahead(message.get_seq(), now_s)
        is_ahead |= message.get_type() in _AS_GOOD_LATE and not is_copy
        if not is_copy:
            self._judge()
        return is_ahead if self.counts_up else self._is_latest_of_its_kind(message, is_copy=is_copy)

    def _is_copy(self, message: Message, now_s: float) -> bool:
        key = message.get_seq(), message.get_msgId(), message.get_crc()
        is_copy = now_s - self._seen.get(key, -math.inf) <= _COPIED_WITHIN_S
        self._seen[key] = now_s
        if len(self._seen) > _REMEMBERED:
            self._seen.popitem(last=False)
        return is_copy

    def _is_ahead(self, number: int, now_s: float) -> bool:
        """Whether the number is ahead of the newest number, or repeats it after a while."""
        newest, leapt_to = self._newest, self._leapt_to
        step = 1 if newest is None else (number - newest) % 256
        if step == 0:
            is_anew = now_s - self._newest_s > _COPIED_WITHIN_S
            self._newest_s = now_s if is_anew else self._newest_s
            return is_anew
        if step >= 256 - _LATE_BY or number == leapt_to:
            return False
        follows = leapt_to is not None and 0 < (number - leapt_to) % 256 <= _LATE_BY
        if step <= _SMALL_STEP or follows:
            self._newest, self._newest_s, self._leapt_to = number, now_s, None
            self._counted += step
        else:
            self._leapt_to = number
        return True

    def _judge(self) -> None:
        self._distinct += 1
        if self._distinct < _JUDGED_EACH:
            return
        step = self._counted / self._distinct
        self.counts_up = _LEAST_STEP <= step <= _LARGEST_STEP
        self.wrong_times = 0 if self.counts_up else self.wrong_times + 1
        self.received_share = min(1.0, 1 / step) if self.counts_up else 1.0
        self._distinct = self._counted = 0

    def _is_latest_of_its_kind(self, message: Message, *, is_copy: bool) -> bool:
        boot_ms = getattr(message, "time_boot_ms", None)
        if boot_ms is None:
            return True
        late_by_ms = self._boot_ms.get(message.get_msgId(), -math.inf) - boot_ms
        if 0 < late_by_ms < _LATE_BY_MS or (late_by_ms == 0 and is_copy):
            return False
        self._boot_ms[message.get_msgId()] = boot_ms
        return True


class BootClock:
    """The vehicle's own clock, and its restarts, from times since boot. `elapsed_s` never goes back."""

    def __init__(self) -> None:
        self.elapsed_s = 0.0
        self.boot_s = -math.inf
        self._heard_s = -math.inf
        self._restarted_s: float | None = None  # when a smaller time, perhaps of a restart, was first heard
        self._leapt_s: float | None = None  # when a time too far ahead was first heard

    def take(self, boot_s: float, now_s: float) -> bool:
        """Take in a time since boot that has just arrived; return whether the vehicle has restarted."""
        step_s, passed_s = boot_s - self.boot_s, now_s - self._heard_s
        first, self._heard_s = math.isinf(self.boot_s), now_s
        if first:
            self.boot_s = boot_s
            return False
        if step_s < -_OUT_OF_ORDER_S:
            return self._goes_back(boot_s, now_s, passed_s)
        self._restarted_s = None
        if step_s > _AHEAD_S + _FASTEST * passed_s:
            self._leaps(boot_s, now_s, passed_s)
            return False
        self._leapt_s = None
        self.elapsed_s += max(0.0, step_s)
        self.boot_s = max(boot_s, self.boot_s)
        return False

    def _leaps(self, boot_s: float, now_s: float, passed_s: float) -> None:
        """Accept a leap if no other time comes between: after a false time, all true times look like restarts."""
        self.elapsed_s += passed_s
        if self._leapt_s is None:
            self._leapt_s = now_s
        if now_s - self._leapt_s >= _CONFIRMED_AFTER_S:
            self.boot_s, self._leapt_s = boot_s, None

    def _goes_back(self, boot_s: float, now_s: float, passed_s: float) -> bool:
        self.elapsed_s += passed_s
        if self._restarted_s is None:
            self._restarted_s = now_s
        if passed_s < _PAUSE_S and now_s - self._restarted_s < _CONFIRMED_AFTER_S:
            return False
        self.boot_s, self._restarted_s = boot_s, None
        return True
