"""Which messages of a vehicle are news, and which come twice or late.

A vehicle numbers its messages, so that a message which was overtaken is known by its number. Not all numbers that
arrive are the vehicle's: bridges pack each message with number 0, count each kind of message by itself, or merge two
streams. What holds for all true numbers is that no more distinct messages come than the numbers count. Where more
come, or the numbers leap about, they say nothing of the order, and the time since boot that some messages hold has
to do.
"""

from __future__ import annotations

import math
from collections import OrderedDict

from upwash.real.mavlink.hearing import Message

_LATE_BY = 64  # messages, about a second: what is older by its number comes from a restarted vehicle
_LATE_BY_MS = 2000  # the same by the time since boot
_SMALL_STEP = 8  # a larger one is a gap of lost messages if a later number follows, else a stranger's number
_JUDGED_EACH = 32  # distinct messages
_LEAST_STEP, _LARGEST_STEP = 0.75, 16.0  # on average: some come late, and 15 of 16 may be lost
_REMEMBERED = 64  # messages, to know those that come twice
_COPIED_WITHIN_S = 0.5  # a repetition after that is the vehicle's, not the link's


class Numbering:
    """The sequence numbers of one vehicle's messages."""

    def __init__(self) -> None:
        self.counts_up = True  # whether the numbers tell the order
        self.wrong_times = 0  # in a row that they were found not to
        self.received_share = 1.0  # of the messages that the vehicle sent, at the last judgement
        self._newest: int | None = None
        self._newest_s = -math.inf
        self._leapt_to: int | None = None  # a number far ahead, which none has followed yet
        self._distinct = self._counted = 0
        self._seen: OrderedDict[tuple[int, int, int], float] = OrderedDict()
        self._boot_ms: dict[int, int] = {}  # the latest time since boot, by message number

    def is_news(self, message: Message, now_s: float, *, linked: bool) -> bool:
        """Whether it is no copy, and no later message came before it; after a silence each message is news."""
        if not linked:
            self._forget()
        is_copy = self._is_copy(message, now_s)
        is_ahead = self._is_ahead(message.get_seq(), now_s)
        if not is_copy:
            self._judge()
        return is_ahead if self.counts_up else self._is_latest_of_its_kind(message, is_copy=is_copy)

    def _forget(self) -> None:
        self._newest = self._leapt_to = None
        self._distinct = self._counted = 0
        self._boot_ms.clear()

    def _is_copy(self, message: Message, now_s: float) -> bool:
        key = message.get_seq(), message.get_msgId(), message.get_crc()
        is_copy = now_s - self._seen.get(key, -math.inf) <= _COPIED_WITHIN_S
        self._seen[key] = now_s
        if len(self._seen) > _REMEMBERED:
            self._seen.popitem(last=False)
        return is_copy

    def _is_ahead(self, number: int, now_s: float) -> bool:
        """Whether the number is ahead of the newest, which it then is, or may become; or the same, after a while."""
        newest, leapt_to = self._newest, self._leapt_to
        step = 1 if newest is None else (number - newest) % 256
        if step == 0:
            return self._is_said_anew(now_s)
        if step >= 256 - _LATE_BY or number == leapt_to:
            return False
        follows = leapt_to is not None and 0 < (number - leapt_to) % 256 <= _LATE_BY
        if step <= _SMALL_STEP or follows:
            self._newest, self._newest_s, self._leapt_to = number, now_s, None
            self._counted += step
        else:
            self._leapt_to = number
        return True

    def _is_said_anew(self, now_s: float) -> bool:
        is_anew = now_s - self._newest_s > _COPIED_WITHIN_S
        if is_anew:
            self._newest_s = now_s
        return is_anew

    def _judge(self) -> None:
        """Judges the numbers once in 32 distinct messages."""
        self._distinct += 1
        if self._distinct < _JUDGED_EACH:
            return
        step = self._counted / self._distinct
        self.counts_up = _LEAST_STEP <= step <= _LARGEST_STEP
        self.wrong_times = 0 if self.counts_up else self.wrong_times + 1
        self.received_share = min(1.0, 1 / step) if self.counts_up else 1.0
        self._distinct = self._counted = 0

    def _is_latest_of_its_kind(self, message: Message, *, is_copy: bool) -> bool:
        """By its time since boot, where it holds one."""
        boot_ms = getattr(message, "time_boot_ms", None)
        if boot_ms is None:
            return True
        late_by_ms = self._boot_ms.get(message.get_msgId(), boot_ms - 1) - boot_ms
        if 0 < late_by_ms < _LATE_BY_MS or (late_by_ms == 0 and is_copy):
            return False
        self._boot_ms[message.get_msgId()] = boot_ms
        return True
