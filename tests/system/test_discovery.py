"""Servers that are announced in the network, found there, and believed by their certificates alone."""

from __future__ import annotations

import functools
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from tests.system.daemons import MAX_MESSAGE_BYTES, config, daemon, shown

from upwash.drone.networks import NoNetwork
from upwash.drone.server_session import ServerEndpoint, ServerSession
from upwash.errors import Unreachable
from upwash.real.link.link import GrpcDialer
from upwash.real.network.discovery import announcing, find
from upwash.real.trust.authority import make_keys

# One at a time: all announce servers of the same names on the same network.
pytestmark = [pytest.mark.system, pytest.mark.xdist_group("discovery")]

HERE = "127.0.0.1"
look = functools.partial(find, within_s=5.0, interface=HERE)


@asynccontextmanager
async def session_of(keys: Path, *services: str) -> AsyncIterator[ServerSession]:
    """A drone's at s1, whose address it does not know."""
    session = ServerSession(
        ServerEndpoint(name="s1", network="", address="mdns", services=services, finder=look),
        network=NoNetwork(),
        dialer=GrpcDialer("heron", shown(keys, "heron"), max_message_bytes=MAX_MESSAGE_BYTES),
    )
    try:
        await session.join(timeout_s=1.0)
        yield session
    finally:
        await session.end(in_range=True)


async def test_what_is_announced_is_found_until_it_is_announced_no_more() -> None:
    async with announcing(["s1", "s2"], HERE, 7070):
        assert await look("s1") == "127.0.0.1:7070"
        assert await look("s2") == "127.0.0.1:7070"
    with pytest.raises(Unreachable, match=r"s1: it was not announced in this network within 1 s"):
        await find("s1", within_s=1.0, interface=HERE)


async def test_a_server_at_an_ipv6_address_is_announced_and_found() -> None:
    async with announcing(["s6"], "[::1]", 7070):
        assert await find("s6", within_s=5.0) == "[::1]:7070"


async def test_a_drone_finds_a_daemon_and_its_services_by_the_servers_name(
    tmp_path: Path, keys: Path
) -> None:
    with daemon(tmp_path, config(keys, announce=True)):
        async with session_of(keys, "workbench") as session:
            await session.ask()
            assert not session.running
            await session.start(timeout_s=60.0)
            assert await session.call("workbench", "process_id", b"\x80", deadline_s=10.0)


async def test_who_announces_a_server_without_its_certificate_is_not_believed(
    tmp_path: Path, keys: Path
) -> None:
    make_keys(tmp_path / "stranger", servers=[["s1", "s2"]])
    with daemon(tmp_path, config(tmp_path / "stranger", announce=True)):
        async with session_of(keys) as session:
            with pytest.raises(Unreachable, match=r"s1 at 127\.0\.0\.1"):
                await session.ask()
