"""The reports that a vehicle is asked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

_ASKED_AT_ONCE = 10  # times that a missing stream is asked for each second
_ASKED_EACH = 30  # and from then on only each so many


class Streams:
    """Asks for the reports that the driver needs, and again where one stopped.

    `ask` sends the request for a message number at an interval in microseconds.
    """

    def __init__(self, ask: Callable[[int, float], None], *, quiet_after_s: float) -> None:
        self._ask = ask
        self._quiet_after_s = quiet_after_s
        self._heard_s: dict[int, float] = {}  # when, by message number
        self._asked_times: dict[int, int] = {}  # by message number, since it last came

    def heard(self, number: int, now_s: float) -> None:
        """A message of that number has come."""
        self._heard_s[number] = now_s

    def heard_s(self, number: int) -> float:
        """When a message of that number last came; minus infinity where none did."""
        return self._heard_s.get(number, -math.inf)

    def ask_for_missing(self, wanted_hz: Mapping[int, float], now_s: float, *, linked: bool) -> None:
        """Asks at the start, and again where a request was lost or the autopilot was restarted."""
        for number, rate_hz in wanted_hz.items():
            if self.heard_s(number) >= now_s - self._quiet_after_s:
                self._asked_times.pop(number, None)
            elif self._is_to_be_asked_for(number, linked=linked):
                self._ask(number, 1e6 / rate_hz)

    def _is_to_be_asked_for(self, number: int, *, linked: bool) -> bool:
        """Ever more rarely: some reports never come, such as ArduCopter's of a fence that is switched off."""
        times = self._asked_times.get(number, 0)
        if linked:
            self._asked_times[number] = times + 1
        return times < _ASKED_AT_ONCE or times % _ASKED_EACH == 0
