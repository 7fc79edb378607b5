"""The parts of services that run on the drone before a call is sent, and make its request smaller.

Each runs in a process of its own, beside the service's: a photo that kills it costs the call a moment, and a long
call of the drone's own service does not hold it up.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from msgspec import Struct

from upwash.drone.onboard import OnboardServices
from upwash.errors import InstanceError, UpwashError
from upwash.eventlog import schema
from upwash.ports import Journal
from upwash.rpc.service import Method
from upwash.support.background import begin, end
from upwash.support.text import worded

_LEAST_S, _FACTOR = 0.5, 4.0  # times its usual time: a part that takes longer hangs
_OF_DEADLINE = 0.5  # the rest is for the call sent whole


class NotReduced(UpwashError):
    """A part before sending gave no smaller request; the message says why."""


class RunningPart(Struct, frozen=True):
    """A part before sending, by its own name, and the time (s) that it usually takes."""

    name: str
    takes_s: float
    onboard: OnboardServices


@dataclass(eq=False)
class BeforeSending:
    """Runs the parts before sending, each known by the service whose requests it makes smaller."""

    parts: Mapping[str, RunningPart]
    journal: Journal
    _trying: Sequence[asyncio.Task[Any]] = field(default=(), init=False)

    async def start(self) -> None:
        """Start each part; a part that does not start is logged, and fails at each call."""
        for part in self.parts.values():
            try:
                await part.onboard.start()
            except InstanceError as error:
                self.journal.record(schema.LocalFailed(service=part.name, why=str(error)))

    async def reduce(self, service: str, method: Method, request: bytes, *, deadline_s: float) -> bytes:
        """The request made smaller, or as it is if it has no smaller form; takes at most half of the deadline.

        Raises NotReduced.
        """
        if (part := self.parts.get(service)) is None:
            raise NotReduced(f"{service} has no part that was started")
        within_s = min(_OF_DEADLINE * deadline_s, max(_LEAST_S, _FACTOR * part.takes_s))
        trying = begin(self._reduced(part, method, request, within_s))
        # It is not cancelled: a part that hangs is stopped at its end.
        self._trying = [*(each for each in self._trying if not each.done()), trying]
        await asyncio.wait([trying], timeout=within_s)
        if not trying.done():
            raise NotReduced(f"{part.name} took longer than {within_s:.2f} s")
        reduced = trying.result()
        if isinstance(reduced, str):
            raise NotReduced(reduced)
        return reduced

    async def _reduced(
        self, part: RunningPart, method: Method, request: bytes, within_s: float
    ) -> bytes | str:
        try:
            asked = method.request_of_part(request)
            reply = await part.onboard.call(part.name, method.name, asked, timeout_s=within_s, once=True)
            reduced = method.reduced(request, reply)
        except InstanceError as error:
            return str(error.__cause__ or error)
        except Exception as error:  # noqa: BLE001 - whatever it is, the call goes on
            return f"{part.name}: {worded(error)}"
        if len(reduced) > len(request):
            return f"{part.name} made {len(request):,} bytes to {len(reduced):,}"
        return reduced if len(reduced) < len(request) else request

    async def close(self) -> None:
        """End each part."""
        await end(*self._trying)
        for part in self.parts.values():
            await part.onboard.close()
