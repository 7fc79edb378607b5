"""A program's end of the control line to one service instance, whatever carries it.

The other end may be a service that means harm. What it says is bounded in length and number, and heard only where
it can be so: calls of drones that it was told to admit, answers to these by methods that its service declares, after
no longer than it has been running.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Callable

import msgspec

from upwash import ports
from upwash.core.admission.limits import Allowance
from upwash.errors import InstanceError
from upwash.real.instances.control import (
    MOST_REPORTS_PER_S,
    Admit,
    Admitted,
    Answered,
    Begin,
    Called,
    Drain,
    Drained,
    Ended,
    Failed,
    FromInstance,
    Ready,
    Said,
    from_instance,
    line,
)
from upwash.real.instances.output import Output
from upwash.real.link.streams import hang_up
from upwash.support.background import start
from upwash.support.text import words_of

_log = logging.getLogger("upwash.instance")

_ADMIT_S = 5.0
LONGEST_LINE_BYTES = 2**17  # what a container's init may say at once
_LONGEST_REASON = 10_000  # characters of why it cannot serve
# Twice what an instance keeps to; at once, what may wait in between while this program is busy.
_MOST_MESSAGES_PER_S = 2 * MOST_REPORTS_PER_S
_MOST_MESSAGES_AT_ONCE = 10_000
_MOST_BYTES_PER_S = 2**20  # above all a container's output, of which its init passes on a quarter of that
_MOST_BYTES_AT_ONCE = 2**24


class InstanceControl:
    """Tells the instance what to be and whom to admit; hears who called, what it prints, and when it is gone."""

    def __init__(
        self,
        name: str,
        called: Callable[[str], None],
        output: Output,
        *,
        answered: ports.Answered = ports.ignored,
        methods: frozenset[str] = frozenset(),
        reports: asyncio.StreamReader,
        orders: asyncio.StreamWriter,
    ) -> None:
        self.code: int | None = None  # with which a container's service ended, if it said so
        self.fault = ""  # why this end hung up
        self._name = name
        self.called = called
        self.answered = answered
        self._methods = methods  # that the service declares
        self._admitted: frozenset[str] = frozenset()
        self._told = Admit([])  # last
        self._ready_s = 0.0
        self._messages = Allowance(_MOST_MESSAGES_PER_S, at_once=_MOST_MESSAGES_AT_ONCE)
        self._bytes = Allowance(_MOST_BYTES_PER_S, at_once=_MOST_BYTES_AT_ONCE)
        self._output = output
        self._reports = reports
        self._orders = orders
        self._admissions: deque[asyncio.Future[None]] = deque()
        self._drained: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._listening: asyncio.Task[None] | None = None

    async def begin(self, begin: Begin) -> str:
        """Tells the instance what to be; returns the address that it serves at once it does.

        Raises InstanceError with its reason, and EOFError where it ended without one.
        """
        self._orders.write(line(begin))
        while True:
            match await self._hear():
                case Ready(address):
                    self._ready_s = _now_s()
                    self._listening = start(
                        self._listen(), name=f"the control line of {self._name}", failed=self._lose
                    )
                    return address
                case Failed(why):
                    raise InstanceError(f"{self._name} did not start: {words_of(why[:_LONGEST_REASON])}")
                case Said(output, left_out):
                    self._output.add(output, left_out=left_out)
                case None if self.fault:
                    raise InstanceError(f"{self._name} did not start: {self.fault}")
                case None | Ended():
                    raise EOFError
                case other:
                    raise InstanceError(f"{self._name} said {type(other).__name__} before it was ready")

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None:
        """Has only these drones get an answer; raises InstanceError where the instance does not confirm it."""
        self._told, self._admitted = Admit(sorted(drones), sorted(finishing)), drones | finishing
        try:
            async with asyncio.timeout(_ADMIT_S):
                await self.health()
        except TimeoutError:
            raise InstanceError(f"{self._name} does not answer its runtime") from None

    async def health(self) -> None:
        """Returns once the instance confirms whom it serves; raises InstanceError where it is gone."""
        confirmed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._tell(self._told)
        self._admissions.append(confirmed)
        await confirmed

    async def drain(self, why: str) -> None:
        """Has every further call refused for that reason; returns when none is under way, or nothing is left."""
        self._tell(Drain(why))
        await asyncio.shield(self._drained)

    @property
    def is_over(self) -> bool:
        """Whether the other end is gone, or never said that it serves."""
        return self._listening is None or self._listening.done()

    async def ended(self) -> None:
        """Returns when the other end is gone."""
        if self._listening is not None:
            await asyncio.wait([self._listening])

    async def close(self) -> None:
        """Hangs up, by which the instance ends."""
        if self._listening is not None:
            self._listening.cancel()
        hang_up(self._orders.transport)  # whoever is frozen takes no part in a farewell
        with contextlib.suppress(OSError):
            await self._orders.wait_closed()

    def _tell(self, message: Admit | Drain) -> None:
        if self.is_over:
            raise InstanceError(f"{self._name} is gone")
        self._orders.write(line(message))

    async def _hear(self) -> FromInstance | None:
        """The next message; None at the end, and where the line broke or this end has to hang up."""
        try:
            text = await self._reports.readline()
            message = from_instance.decode(text) if text else None
        except OSError:
            return None
        except (ValueError, RecursionError, msgspec.MsgspecError):
            self._hang_up("it said something that cannot be understood")
            return None
        if not (self._messages.take(1, now_s=_now_s()) and self._bytes.take(len(text), now_s=_now_s())):
            self._hang_up("it said too much over its control line")
            return None
        if isinstance(message, Ended):
            self.code = message.code
        return message

    def _lose(self, defect: Exception) -> None:
        self._hang_up(f"a defect in hearing it: {type(defect).__name__}: {defect}")

    def _hang_up(self, why: str) -> None:
        self.fault = why
        _log.warning("%s: %s: hanging up", self._name, why)
        hang_up(self._orders.transport)

    async def _listen(self) -> None:
        try:
            while not self.fault and (message := await self._hear()) is not None:
                self._take_in(message)
        finally:
            for confirmed in self._admissions:
                if not confirmed.done():
                    confirmed.set_exception(InstanceError(f"{self._name} is gone"))
            if not self._drained.done():
                self._drained.set_result(None)

    def _take_in(self, message: FromInstance) -> None:
        match message:
            case Called(drone):
                if drone in self._admitted:
                    self.called(drone)
            case Answered():
                if self._can_be_so(message):
                    self.answered(
                        ports.AnsweredCall(
                            message.drone, message.method, message.queued_s, message.took_s, message.outcome
                        )
                    )
            case Admitted() if self._admissions:
                confirmed = self._admissions.popleft()
                if not confirmed.done():
                    confirmed.set_result(None)
            case Drained() if not self._drained.done():
                self._drained.set_result(None)
            case Said(output, left_out):
                self._output.add(output, left_out=left_out)
            case Ended():
                pass
            case _:
                self._hang_up("it said something out of turn")

    def _can_be_so(self, call: Answered) -> bool:
        return (
            call.drone in self._admitted
            and call.method in self._methods
            and min(call.queued_s, call.took_s) >= 0.0
            and call.queued_s + call.took_s <= _now_s() - self._ready_s
        )


def _now_s() -> float:
    return asyncio.get_running_loop().time()
