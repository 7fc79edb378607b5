"""A drone that calls without a pause, for tests of what an operator changes meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from tests.system.daemons import MAX_MESSAGE_BYTES, shown

from upwash.drone.networks import NoNetwork
from upwash.drone.server_session import ServerEndpoint, ServerSession
from upwash.real.link.link import GrpcDialer
from upwash.rpc.service import load_service, spec_of


class Flying:
    """A drone that calls a service of a server all the time, as its own session has it; no call may fail.

    `program` is the path of the service's class, whose `method` takes nothing and returns a number.
    """

    def __init__(
        self,
        name: str,
        address: str,
        keys: Path,
        program: str,
        method: str = "process_id",
        *,
        server: str = "s1",
        pause_s: float = 0.02,
    ) -> None:
        self.answered: list[int] = []  # what was answered, one after the other
        self._pause_s = pause_s  # between an answer and the next call
        self._called = asyncio.Event()  # is set, and replaced, at each answer
        spec = spec_of(load_service(program))
        self._service, self._method = spec.name, spec.methods[method]
        self._session = ServerSession(
            ServerEndpoint(name=server, network="", address=address, services=(spec.name,)),
            network=NoNetwork(),
            dialer=GrpcDialer(name, shown(keys, name), max_message_bytes=MAX_MESSAGE_BYTES),
        )

    async def called(self) -> None:
        """Returns when the next call is answered."""
        await self._called.wait()

    async def answered_by(self, processes: int) -> None:
        """Returns when so many processes have answered, one after the other."""
        while len(set(self.answered)) < processes:
            await self.called()

    async def hears(self, answer: int) -> None:
        """Returns when that is answered from now on."""
        known = len(self.answered)
        while answer not in self.answered[known:]:
            await self.called()

    async def fly(self, until: asyncio.Event, arrived: Callable[[], None]) -> None:
        session = self._session
        await session.join(timeout_s=5.0)
        await session.ask()
        if not session.running:
            await session.start(timeout_s=60.0)
        keeping = asyncio.create_task(session.keep_lease())
        arrived()
        try:
            while not until.is_set():
                _, request = self._method.encode((), {})
                reply = await session.call(self._service, self._method.name, request, deadline_s=10.0)
                self.answered.append(int(str(self._method.result(self._method.decode(reply)))))
                self._called.set()
                self._called = asyncio.Event()
                await asyncio.sleep(self._pause_s)
            assert not keeping.done(), keeping.exception()
        finally:
            keeping.cancel()
            await session.end(in_range=True)
