"""A program's end of the control line to one service instance, whatever carries it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Callable

import msgspec

from upwash import ports
from upwash.errors import InstanceError
from upwash.real.control import (
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
from upwash.real.output import Output

_log = logging.getLogger("upwash.instance")

_ADMIT_S = 5.0
LONGEST_LINE_BYTES = 2**17  # what a container's warden may say at once


class Conversation:
    """Tells the instance what to be and whom to admit; hears who called, what it prints, and when it is gone."""

    def __init__(
        self,
        name: str,
        called: Callable[[str], None],
        output: Output,
        *,
        answered: ports.Answered = ports.unheard,
        reports: asyncio.StreamReader,
        orders: asyncio.StreamWriter,
    ) -> None:
        self.code: int | None = None  # with which a container's service ended, if it said so
        self._name = name
        self.called = called
        self.answered = answered
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
                    self._listening = asyncio.create_task(self._listen())
                    return address
                case Failed(why):
                    raise InstanceError(f"{self._name} did not start: {why}")
                case Said(output):
                    self._output.add(output)
                case None | Ended():
                    raise EOFError
                case other:
                    raise InstanceError(f"{self._name} said {other} before it was ready")

    async def admit(self, drones: frozenset[str]) -> None:
        """Has only these drones get an answer; raises InstanceError where the instance does not confirm it."""
        confirmed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._tell(Admit(sorted(drones)))
        self._admissions.append(confirmed)
        try:
            async with asyncio.timeout(_ADMIT_S):
                await confirmed
        except TimeoutError:
            raise InstanceError(f"{self._name} does not answer its runtime") from None

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
        self._orders.transport.abort()  # whoever is frozen takes no part in a farewell
        with contextlib.suppress(OSError):
            await self._orders.wait_closed()

    def _tell(self, message: Admit | Drain) -> None:
        if self.is_over:
            raise InstanceError(f"{self._name} is gone")
        self._orders.write(line(message))

    async def _hear(self) -> FromInstance | None:
        """The next message; None at the end, and where the line broke or carries what nobody understands."""
        try:
            text = await self._reports.readline()
            message = from_instance.decode(text) if text else None
        except OSError:
            return None
        except (ValueError, RecursionError, msgspec.MsgspecError):
            _log.warning("%s said something that cannot be understood: hanging up", self._name)
            return None
        if isinstance(message, Ended):
            self.code = message.code
        return message

    async def _listen(self) -> None:
        try:
            while (message := await self._hear()) is not None:
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
                self.called(drone)
            case Answered(method, took_s):
                self.answered(method, took_s)
            case Admitted() if self._admissions:
                confirmed = self._admissions.popleft()
                if not confirmed.done():
                    confirmed.set_result(None)
            case Drained() if not self._drained.done():
                self._drained.set_result(None)
            case Said(output):
                self._output.add(output)
            case Ended():
                pass
            case _:
                _log.warning("%s said something out of turn", self._name)
