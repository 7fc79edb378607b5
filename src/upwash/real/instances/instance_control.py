"""The program's end of a service instance: its control line, and what all kinds of instances share.

The other end may be a hostile service. Its messages are limited in length and number, and reports count only if they
are possible: calls of admitted drones, of declared methods, no longer than the instance has run.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass

import msgspec

from upwash import ports
from upwash.core.admission.limits import Allowance
from upwash.errors import InstanceError
from upwash.real.instances import control
from upwash.real.instances.output import InstanceOutput
from upwash.real.link.door import Entrance, Lead
from upwash.real.link.proxy import Connect
from upwash.real.link.streams import hang_up
from upwash.support.background import first, start
from upwash.support.text import worded, words_of

_log = logging.getLogger("upwash.instance")

_ADMIT_S = 5.0
LONGEST_LINE_BYTES = 2**17  # the longest message of a container's process 1
_LONGEST_REASON = 10_000  # characters
# Twice what an instance sends at most; a backlog may form while this program is busy.
_MOST_MESSAGES_PER_S = 2 * control.MOST_REPORTS_PER_S
_MOST_MESSAGES_AT_ONCE = 10_000
_MOST_BYTES_PER_S = 2**20  # mostly output: a container's process 1 passes on a quarter of this
_MOST_BYTES_AT_ONCE = 2**24


class InstanceControl:
    """Sends an instance its orders, and receives its reports until the instance is gone."""

    def __init__(
        self,
        spec: ports.InstanceSpec,
        output: InstanceOutput,
        *,
        called: Callable[[str], None],
        answered: ports.Answered,
        reports: asyncio.StreamReader,
        orders: asyncio.StreamWriter,
    ) -> None:
        self.code: int | None = None  # the exit code that a container reported
        self.fault = ""  # why this end hung up
        self.called = called
        self.answered = answered
        self._name = spec.name
        self._methods = spec.methods
        self._admitted: frozenset[str] = frozenset()
        self._last_order = control.AdmitDrones([])
        self._ready_s = 0.0
        self._messages = Allowance(_MOST_MESSAGES_PER_S, at_once=_MOST_MESSAGES_AT_ONCE)
        self._bytes = Allowance(_MOST_BYTES_PER_S, at_once=_MOST_BYTES_AT_ONCE)
        self._output = output
        self._reports = reports
        self._orders = orders
        self._admissions: deque[asyncio.Future[None]] = deque()
        self._drained: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._listening: asyncio.Task[None] | None = None

    async def begin(self, begin: control.Begin) -> str:
        """The address at which the instance serves, once it is ready.

        Raises InstanceError with the instance's reason, and EOFError if the line ended without a reason.
        """
        self._orders.write(control.line(begin))
        while True:
            match await self._receive():
                case control.Ready(address):
                    self._ready_s = _now_s()
                    self._listening = start(
                        self._listen(), name=f"the control line of {self._name}", failed=self._lose
                    )
                    return address
                case control.InstanceFailed(why):
                    raise InstanceError(f"{self._name} did not start: {words_of(why[:_LONGEST_REASON])}")
                case control.Printed(output, left_out):
                    self._output.add(output, left_out=left_out)
                case None if self.fault:
                    raise InstanceError(f"{self._name} did not start: {self.fault}")
                case None | control.ServiceEnded():
                    raise EOFError
                case other:
                    raise InstanceError(f"{self._name} sent {type(other).__name__} before it was ready")

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None:
        """Have only these drones answered; raises InstanceError if the instance does not confirm it in 5 s."""
        self._last_order = control.AdmitDrones(sorted(drones), sorted(finishing))
        self._admitted = drones | finishing
        try:
            async with asyncio.timeout(_ADMIT_S):
                await self.health()
        except TimeoutError:
            raise InstanceError(f"{self._name} does not answer its runtime") from None

    async def health(self) -> None:
        """Return once the instance confirms its last admission; raises InstanceError if it is gone."""
        confirmed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._send(self._last_order)
        self._admissions.append(confirmed)
        await confirmed

    async def drain(self, why: str) -> None:
        """Have further calls refused for that reason; returns when no call is in progress, or the line ended."""
        self._send(control.Drain(why))
        await asyncio.shield(self._drained)

    @property
    def is_over(self) -> bool:
        """Whether the instance is gone, or was never ready."""
        return self._listening is None or self._listening.done()

    async def ended(self) -> None:
        """Return when the instance is gone."""
        if self._listening is not None:
            await asyncio.wait([self._listening])

    async def close(self) -> None:
        """Hang up, which ends the instance."""
        if self._listening is not None:
            self._listening.cancel()
        hang_up(self._orders.transport)  # a frozen process never closes its end
        with contextlib.suppress(OSError):
            await self._orders.wait_closed()

    def _send(self, message: control.AdmitDrones | control.Drain) -> None:
        if self.is_over:
            raise InstanceError(f"{self._name} is gone")
        self._orders.write(control.line(message))

    async def _receive(self) -> control.FromInstance | None:
        """The next message; None at the end of the line, also if this end has to hang up."""
        try:
            text = await self._reports.readline()
            message = control.from_instance.decode(text) if text else None
        except OSError:
            return None
        except (ValueError, RecursionError, msgspec.MsgspecError):
            self._hang_up("it sent a message that cannot be decoded")
            return None
        if not (self._messages.take(1, now_s=_now_s()) and self._bytes.take(len(text), now_s=_now_s())):
            self._hang_up("it sent too much over its control line")
            return None
        if isinstance(message, control.ServiceEnded):
            self.code = message.code
        return message

    def _lose(self, defect: Exception) -> None:
        self._hang_up(f"a defect in reading its messages: {worded(defect)}")

    def _hang_up(self, why: str) -> None:
        self.fault = why
        _log.warning("%s: %s: hanging up", self._name, why)
        hang_up(self._orders.transport)

    async def _listen(self) -> None:
        try:
            while not self.fault and (message := await self._receive()) is not None:
                self._take_in(message)
        finally:
            for confirmed in self._admissions:
                if not confirmed.done():
                    confirmed.set_exception(InstanceError(f"{self._name} is gone"))
            if not self._drained.done():
                self._drained.set_result(None)

    def _take_in(self, message: control.FromInstance) -> None:
        match message:
            case control.Called(drone):
                if drone in self._admitted:
                    self.called(drone)
            case control.Answered():
                if self._is_possible(message):
                    self.answered(
                        ports.AnsweredCall(
                            message.drone, message.method, message.queued_s, message.took_s, message.outcome
                        )
                    )
            case control.Admitted() if self._admissions:
                confirmed = self._admissions.popleft()
                if not confirmed.done():
                    confirmed.set_result(None)
            case control.Drained() if not self._drained.done():
                self._drained.set_result(None)
            case control.Printed(output, left_out):
                self._output.add(output, left_out=left_out)
            case control.ServiceEnded():
                pass
            case _:
                self._hang_up("it sent a message out of turn")

    def _is_possible(self, call: control.Answered) -> bool:
        return (
            call.drone in self._admitted
            and call.method in self._methods
            and min(call.queued_s, call.took_s) >= 0.0
            and call.queued_s + call.took_s <= _now_s() - self._ready_s
        )


@dataclass(frozen=True, slots=True)
class InstanceCallbacks:
    """What an instance calls: `called` and `answered` for its calls, `lead` to let callers in through the door.

    With a `keep` it is frozen instead of stopped, and given to that.
    """

    called: Callable[[str], None]
    answered: ports.Answered
    lead: Lead | None = None
    keep: Callable[[ControlledInstance], None] | None = None


class ControlledInstance(ABC):
    """An instance with a control line, whatever it runs in."""

    def __init__(self, spec: ports.InstanceSpec, callbacks: InstanceCallbacks) -> None:
        self.spec = spec
        self.endpoint = ""
        self._callbacks = callbacks
        self._lead = callbacks.lead
        self._keep = callbacks.keep
        self._entrance: Entrance | None = None
        self._output = InstanceOutput(spec.name)
        self._control: InstanceControl | None = None
        self._stopped = asyncio.Event()

    @property
    def control(self) -> InstanceControl:
        """The control line of an instance that was started."""
        assert self._control is not None  # noqa: S101 - it has begun
        return self._control

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None:
        """Have only these drones answered; raises InstanceError if the instance does not confirm it."""
        await self.control.admit(drones, finishing)

    async def drain(self, why: str) -> None:
        """Have further calls refused for that reason; returns when no call is in progress.

        The instance never answers again, and is not kept.
        """
        self._keep = None
        await self.control.drain(why)

    async def health(self) -> None:
        """Return at the instance's next reply; raises InstanceError if it is gone."""
        await self.control.health()

    async def exited(self) -> str:
        """How the instance ended, with its last lines of output, once it has; "stopped" for a frozen one."""
        return await first(self.how_it_ended(), self._until_stopped())

    async def stop(self) -> None:
        """Freeze the instance if it is kept, else end it; returns when that is done."""
        if self._keep is None or self.control.is_over:
            await self.end()
        elif not self._stopped.is_set():
            self._stopped.set()
            await self._shut()
            try:
                await self.control.admit(frozenset())
                await self.freeze()
            except InstanceError as error:
                _log.warning("%s cannot be frozen and is stopped: %s", self.spec.name, error)
                await self.end()
            else:
                self._keep(self)

    async def resume(self, *, called: Callable[[str], None], answered: ports.Answered) -> None:
        """Have a frozen instance serve again; raises InstanceError."""
        self._stopped.clear()
        self.control.called, self.control.answered = called, answered
        await self.thaw()
        await self.control.admit(frozenset())
        await self.open()

    @abstractmethod
    async def how_it_ended(self) -> str:
        """How the instance ended, with its last lines of output, once it has."""

    @abstractmethod
    async def end(self) -> None:
        """End the instance, frozen or not; returns when it is gone."""

    @abstractmethod
    async def open(self) -> None:
        """Let callers in through the door; raises InstanceError if the instance cannot be reached."""

    async def freeze(self) -> None:
        """Suspend what runs; raises InstanceError."""
        raise InstanceError(f"{self.spec.name} is a process")

    async def thaw(self) -> None:
        """Let a frozen instance go on; raises InstanceError."""
        raise InstanceError(f"{self.spec.name} is a process")

    def _connect_control(
        self, reports: asyncio.StreamReader, orders: asyncio.StreamWriter
    ) -> InstanceControl:
        self._control = InstanceControl(
            self.spec,
            self._output,
            called=self._callbacks.called,
            answered=self._callbacks.answered,
            reports=reports,
            orders=orders,
        )
        return self._control

    async def _lead_to(self, connect: Connect) -> None:
        if self._lead is not None:
            self._entrance = await self._lead(self.spec.server, connect)
            self.endpoint = self._entrance.endpoint

    async def _shut(self) -> None:
        if self._entrance is not None:
            await self._entrance.close()
            self._entrance = None

    async def _until_stopped(self) -> str:
        await self._stopped.wait()
        return "stopped"


@contextlib.asynccontextmanager
async def starting(instance: ControlledInstance) -> AsyncIterator[None]:
    """Have the start in the block take `start_pace_s` at least; an instance that does not start is ended."""
    now_s = asyncio.get_running_loop().time
    paced_until_s = now_s() + instance.spec.start_pace_s
    try:
        yield
        await asyncio.sleep(paced_until_s - now_s())
    except BaseException:
        await instance.end()
        raise


def _now_s() -> float:
    return asyncio.get_running_loop().time()
