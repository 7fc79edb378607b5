"""Troubles of a vehicle's link that may repeat without end, and what an exception in a message's handling costs."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable

from upwash.eventlog.schema import LinkTroubleName
from upwash.ports import LinkTrouble
from upwash.real.mavlink.hearing import Message

_log = logging.getLogger("upwash.mavlink")


class Troubles:
    """Counts each trouble, and calls `tell` at its first, tenth, hundredth time and so on."""

    def __init__(self, tell: Callable[[LinkTrouble], None]) -> None:
        self._tell = tell
        self._times: Counter[tuple[LinkTroubleName, str]] = Counter()

    def count(self, about: LinkTroubleName, what: str, why: str) -> bool:
        """Counts the trouble with `what`; whether that told it."""
        self._times[about, what] += 1
        times = self._times[about, what]
        is_told = str(times).rstrip("0") == "1"
        if is_told:
            self._tell(LinkTrouble(about, why if times == 1 else f"{why}; so far {times} times"))
        return is_told

    def spare(self, message: Message, step: Callable[[], None]) -> bool:
        """Whether the step took the message in. An exception ends the step alone: it is logged and counted."""
        try:
            step()
        except Exception as error:  # noqa: BLE001 - a defect in one message's handling may not end the connection
            kind = message.get_type()
            why = f"a defect of upwash: {kind} of the vehicle was not taken in ({error!r})"
            if self.count("defect", kind, why):
                _log.error("%s", why, exc_info=error)
            return False
        return True
