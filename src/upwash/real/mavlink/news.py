"""What a person and the log learn of a vehicle and its link: all of it in order, but no flood."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter, deque
from collections.abc import Callable

from upwash.core.admission.limits import Allowance
from upwash.eventlog.schema import (
    AutopilotPhoto,
    HomeMoved,
    LinkTrouble,
    LinkTroubleName,
    PositionDoubted,
    VehicleSaid,
)
from upwash.mavlink.packets import Message
from upwash.ports import VehicleNews

_KEPT = 1000  # until there is a listener
# A vehicle, or a forger, may send these without end.
_UNBOUNDED = VehicleSaid, HomeMoved, PositionDoubted, AutopilotPhoto
_UNBOUNDED_PER_S, _UNBOUNDED_AT_ONCE = 5.0, 100.0
_log = logging.getLogger("upwash.mavlink")


class VehicleNewsFeed:
    """Passes news to a listener, without all repetitions of troubles; keeps them until there is a listener."""

    def __init__(self) -> None:
        self._hear: Callable[[VehicleNews], None] | None = None
        self._unheard: deque[VehicleNews] = deque(maxlen=_KEPT)
        self._unbounded = Allowance(_UNBOUNDED_PER_S, at_once=_UNBOUNDED_AT_ONCE)
        self._told: set[LinkTroubleName] = set()
        self._times: Counter[tuple[LinkTroubleName, str]] = Counter()

    def listen(self, hear: Callable[[VehicleNews], None]) -> None:
        """Calls `hear` with all news from now on, and first with the news since the connection was made."""
        self._hear = hear
        while self._unheard:
            hear(self._unheard.popleft())

    def tell(self, news: VehicleNews) -> None:
        """Passes news to the listener, or keeps them for one; floods are cut to five a second."""
        if isinstance(news, _UNBOUNDED) and not self._unbounded.take(
            1, now_s=asyncio.get_running_loop().time()
        ):
            what = type(news).__name__
            self.count("flood", what, f"the vehicle says more than is told and logged ({what})")
        elif self._hear:
            self._hear(news)
        else:
            self._unheard.append(news)

    def once(self, about: LinkTroubleName, why: str) -> None:
        """Report the first trouble of its kind."""
        if about not in self._told:
            self._told.add(about)
            self.tell(LinkTrouble(about=about, why=why))

    def count(self, about: LinkTroubleName, what: str, why: str) -> bool:
        """Report the first, tenth, hundredth trouble about `what`, and so on; return whether it was reported."""
        self._times[about, what] += 1
        times = self._times[about, what]
        tells = str(times).rstrip("0") == "1"
        if tells:
            self.tell(LinkTrouble(about=about, why=why if times == 1 else f"{why}; so far {times} times"))
        return tells

    def spare(self, message: Message, step: Callable[[], object]) -> bool:
        """Run the step; return whether it succeeded. An exception ends only this step: it is logged and counted."""
        try:
            step()
        except Exception as error:  # noqa: BLE001 - a defect in one message's handling may not end the connection
            kind = message.get_type()
            why = f"a defect of upwash: {kind} of the vehicle was not taken in ({error!r})"
            if self.count("defect", kind, why):
                _log.error("%s", why, exc_info=error)
            return False
        return True
