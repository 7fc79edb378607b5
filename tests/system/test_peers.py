"""Two daemons as processes that are peers: what one gets from the other for a drone, and who else gets nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import msgspec
import pytest
from tests.system.daemons import MAX_MESSAGE_BYTES, Daemon, config, daemon, eventually, guests, shown

from upwash.real.link.link import GrpcDialer
from upwash.real.trust.authority import make_keys
from upwash.real.trust.credentials import Credentials, fingerprint
from upwash.rpc.protocol import (
    HOLD,
    PREPARE,
    HoldReply,
    HoldRequest,
    PrepareRequest,
    decode_reply,
)

Who = tuple[str, Credentials | None]  # a name, and what is shown of it
pytestmark = pytest.mark.system

NOWHERE = "127.0.0.1:9"  # of a peer that is never asked


@contextmanager
def two_daemons(folder: Path, keys: Path | None) -> Iterator[tuple[Daemon, Daemon]]:
    """s1, which can have s2 prepared, and s2."""

    def started(name: str, peer: str, address: str) -> AbstractContextManager[Daemon]:
        (folder / name).mkdir()
        peers = [{"name": peer, "address": address}]
        text = config(keys, server=[{"name": name, "slots": 1}], peer=peers)
        return daemon(folder / name, text.replace("/s1.", f"/{name}."), names=name)

    with started("s2", "s1", NOWHERE) as s2, started("s1", "s2", s2.address) as s1:
        yield s1, s2


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    """An authority, a daemon for each of s1, s2 and s3, and the drones heron and stork."""
    make_keys(tmp_path / "keys", servers=[["s1"], ["s2"], ["s3"]], drones=["heron", "stork"])
    return tmp_path / "keys"


async def ask(at: Daemon, server: str, who: Who, path: str, message: msgspec.Struct) -> HoldReply:
    dialer = GrpcDialer(*who, max_message_bytes=MAX_MESSAGE_BYTES)
    link = dialer.dial(at.address, server=server)
    try:
        reply = await link.request(path, msgspec.msgpack.encode(message), timeout_s=10.0)
    finally:
        await link.close()
    return decode_reply(reply, HoldReply, sender=server)


@pytest.mark.parametrize("certified", [True, False])
async def test_the_service_runs_and_a_slot_is_held_when_the_drone_arrives(
    tmp_path: Path, services: Path, keys: Path, *, certified: bool
) -> None:
    heron, stork = ((name, shown(keys, name) if certified else None) for name in ("heron", "stork"))

    with two_daemons(tmp_path, keys if certified else None) as (s1, s2):
        async with (
            guests(s1, services, (*heron, "s1")) as (leaving,),
            guests(s2, services, (*heron, "s2"), (*stork, "s2")) as (arriving, other),
        ):
            assert (await leaving.availability("workbench")).peers == ["s2"]
            request = PrepareRequest("s1", "s2", ["workbench"], arrives_in_s=8.0, hold_s=15.0)
            assert await ask(s1, "s1", heron, PREPARE, request) == HoldReply(held=True)
            assert not (await other.availability("workbench")).available
            await eventually(lambda: arriving.availability("workbench"), lambda answer: answer.endpoints)
            endpoint = (await arriving.availability("workbench")).endpoints["workbench"]
            assert await arriving.call(endpoint, "echo", b"photo") == b"photo"
        assert "a slot is held for heron, as s1 asked" in s2.said()


async def test_who_is_no_peer_holds_nothing(tmp_path: Path, keys: Path) -> None:
    hold = HoldRequest("s2", "heron", fingerprint(shown(keys, "heron").certificate), ["workbench"], 30.0)
    prepare = PrepareRequest("s1", "s2", ["workbench"], arrives_in_s=8.0, hold_s=15.0)
    with two_daemons(tmp_path, keys) as (s1, s2):
        for name in ("s3", "stork", "heron"):
            reply = await ask(s2, "s2", (name, shown(keys, name)), HOLD, hold)
            assert reply == HoldReply(held=False, reason=f"{name} is no peer of this daemon")
        reply = await ask(s1, "s1", ("heron", shown(keys, "heron")), PREPARE, prepare)
        assert reply == HoldReply(held=False, reason="heron has no lease on s1")
        assert s2.instances() == []
