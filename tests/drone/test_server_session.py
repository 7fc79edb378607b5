"""The drone's session with one server, on virtual time; the server's replies are the test's."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
import pytest

from upwash.core.admission.clients import Client
from upwash.drone.server_session import ServerEndpoint, ServerSession
from upwash.errors import ServerFull, ServicePaused
from upwash.rpc.protocol import AvailabilityReply
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.loop import run_virtually


class Nowhere:
    """A network that is there without being joined."""

    async def join(self, network: str, *, timeout_s: float) -> None:
        pass

    async def leave(self) -> None:
        pass

    async def lost(self) -> str:
        await asyncio.get_running_loop().create_future()
        raise AssertionError


def talk(story: Callable[[ServerSession], Awaitable[Any]], reply: msgspec.Struct) -> Any:
    """Runs a story with a session whose daemon gives that reply to each request."""

    async def daemon(path: str, body: bytes, client: Client) -> bytes:
        return msgspec.msgpack.encode(reply)

    async def run() -> Any:
        dialer = ModelDialer("d1", Switchboard({"s1": daemon}))
        endpoint = ServerEndpoint("s1", "field", "s1", ("detector",))
        return await story(ServerSession(endpoint, network=Nowhere(), dialer=dialer))

    return run_virtually(run())


@pytest.mark.parametrize(
    ("told_s", "kept_s"), [(1e-9, 0.5), (0.5, 0.5), (7.0, 7.0), (30.0, 30.0), (86400.0, 30.0)]
)
def test_the_time_between_two_questions_for_a_slot_is_bounded(told_s: float, kept_s: float) -> None:
    reply = AvailabilityReply(available=False, reason="full", waiting=2, ask_again_s=told_s)
    with pytest.raises(ServerFull, match=r"^s1: full") as refusal:
        talk(ServerSession.ask, reply)
    assert (refusal.value.ask_again_s, refusal.value.waiting) == (kept_s, 2)


@pytest.mark.parametrize(("told_s", "kept_s"), [(1e-9, 1e-9), (600.0, 600.0), (86400.0, 600.0)])
def test_the_time_that_a_server_asks_to_be_left_out_is_bounded(told_s: float, kept_s: float) -> None:
    with pytest.raises(ServicePaused, match=r"^s1 is left out for \d+ s: broken") as refusal:
        talk(ServerSession.ask, AvailabilityReply(available=False, reason="broken", pause_s=told_s))
    assert refusal.value.pause_s == kept_s
