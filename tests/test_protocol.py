"""What drone and daemon say to each other: whatever arrives is a message, or refused."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from upwash.core.instances import Host, HostSettings, ServerOffer
from upwash.core.visitors import Visitor
from upwash.errors import GarbledReply, Refused
from upwash.ports import Instance, InstanceSpec, Link
from upwash.protocol import (
    AVAILABILITY,
    HOLD,
    LEAVE,
    PREPARE,
    START,
    AvailabilityReply,
    HoldReply,
    LeaveReply,
    StartReply,
    decode_reply,
    resolve,
)
from upwash.real.control import Admitted, Answered, Called, Ended, Failed, Ready, Said, line
from upwash.real.conversation import Conversation
from upwash.real.output import Output
from upwash.server import EdgeServer

values: st.SearchStrategy[Any] = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=4)
    | st.binary(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=4,
)
names = st.sampled_from(
    [
        "server",
        "service",
        "services",
        "available",
        "endpoint",
        "endpoints",
        "reason",
        "lease_s",
        "peer",
        "for_s",
    ]
)
messages = st.dictionaries(names, values, max_size=4).map(msgspec.msgpack.encode)
bodies = st.binary(max_size=60) | messages | messages.map(lambda body: body[:-1])


class NoRuntime:
    async def start(self, spec: InstanceSpec, *, called: Callable[[str], None], **_: Any) -> Instance:
        raise AssertionError(f"{spec.name} was started")


class NoDialer:
    def dial(self, address: str, *, server: str) -> Link:
        raise AssertionError(f"{server} was called")


@given(path=st.sampled_from([AVAILABILITY, START, LEAVE, PREPARE, HOLD]), body=bodies)
@example(path=AVAILABILITY, body=b"\x82\xa6server\xa2s1\xa8services\xdd\xff\xff\xff\xff")
@example(path=START, body=b"\x91" * 50_000)
def test_any_request_is_answered_or_refused(path: str, body: bytes) -> None:
    async def ask() -> bytes:
        host = Host({"s1": ServerOffer(frozenset())}, HostSettings())
        daemon = EdgeServer(
            host, images={}, runtime=NoRuntime(), dialer=NoDialer(), drain_s=1.0, start_timeout_s=1.0
        )
        return await daemon.handle(path, body, Visitor("heron"))

    try:
        reply = asyncio.run(ask())
    except Refused:
        return
    assert isinstance(msgspec.msgpack.decode(reply), dict)


@pytest.mark.parametrize("expected", [AvailabilityReply, StartReply, LeaveReply, HoldReply])
@given(reply=bodies)
@example(reply=b"\x91" * 50_000)
def test_any_reply_is_of_its_kind_or_garbled(expected: type[msgspec.Struct], reply: bytes) -> None:
    try:
        assert isinstance(decode_reply(reply, expected, sender="s1"), expected)
    except GarbledReply as error:
        assert "s1" in str(error)


told = st.sampled_from(
    [
        line(each)
        for each in (
            Admitted(),
            Answered("work", 0.1),
            Called("heron"),
            Ended(1),
            Failed("why"),
            Ready(":1"),
            Said(b"words"),
        )
    ]
)


@given(lines=st.lists(told | st.binary(max_size=40).map(lambda text: text + b"\n"), max_size=5))
@example(lines=[b'{"type":"called","drone":"heron","x":' + b"[" * 50_000 + b"\n"])
def test_an_instance_that_says_anything_is_heard_out_or_hung_up_on(lines: list[bytes]) -> None:
    async def hear() -> None:
        reports = asyncio.StreamReader(limit=2**17)
        reports.feed_data(line(Ready("127.0.0.1:1")) + b"".join(lines))
        reports.feed_eof()
        called: list[str] = []
        conversation = Conversation(
            "test@s1",
            called.append,
            Output("test@s1"),
            reports=reports,
            orders=Silent(),  # type: ignore[arg-type]
        )
        begin: Any = Ended(0)  # whatever it is told
        assert await conversation.begin(begin) == "127.0.0.1:1"
        async with asyncio.timeout(5.0):
            await conversation.ended()
        assert conversation.is_over
        assert conversation._listening is not None
        assert conversation._listening.exception() is None
        assert set(called) <= {"heron"}

    asyncio.run(hear())


class Silent:
    """The end of the line that the instance would read."""

    def write(self, _: bytes) -> None:
        """Nobody reads it."""


def test_no_daemon_elsewhere_has_the_drone_call_a_socket_of_its_own() -> None:
    assert resolve(":40000", "10.0.0.1:7070") == "10.0.0.1:40000"
    assert resolve("unix:/run/echo.sock", "unix:/run/daemon.sock") == "unix:/run/echo.sock"
    with pytest.raises(GarbledReply, match=r"unix:/run/other\.sock, which is not its own"):
        resolve("unix:/run/other.sock", "10.0.0.1:7070")
