"""The drone's computer is busy with its radios while they join networks (thesis section 4.4.1)."""

from __future__ import annotations

import asyncio

from upwash.ports import Network


class Joining:
    """How many of the drone's radios are joining a network now."""

    def __init__(self) -> None:
        self._radios = 0
        self._changed = asyncio.Event()

    def begun(self) -> None:
        """One radio more."""
        self._count(1)

    def over(self) -> None:
        """One radio less."""
        self._count(-1)

    async def work(self, work_s: float, slowdown: float) -> None:
        """Returns when work is done that takes `work_s`, and longer by the share `slowdown` while a radio joins."""
        if slowdown == 0:
            await asyncio.sleep(work_s)
            return
        clock, left_s = asyncio.get_running_loop().time, work_s
        while True:
            began_s, changed, stretch = clock(), self._changed, 1 + slowdown if self._radios else 1.0
            try:
                async with asyncio.timeout(left_s * stretch):
                    await changed.wait()
            except TimeoutError:
                return
            left_s -= (clock() - began_s) / stretch

    def _count(self, more: int) -> None:
        self._radios += more
        self._changed.set()
        self._changed = asyncio.Event()


class JoinedSlowly:
    """A network that lets it be known when it is being joined."""

    def __init__(self, network: Network, joining: Joining) -> None:
        self._network = network
        self._joining = joining

    async def join(self, network: str, *, timeout_s: float) -> None:
        """As the network, and noted meanwhile."""
        self._joining.begun()
        try:
            await self._network.join(network, timeout_s=timeout_s)
        finally:
            self._joining.over()

    async def lost(self) -> str:
        """As the network."""
        return await self._network.lost()

    async def leave(self) -> None:
        """As the network."""
        await self._network.leave()
