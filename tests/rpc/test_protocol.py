"""What drone and daemon say to each other: whatever arrives is a message, or refused."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from math import inf, nan
from typing import Any

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from upwash.core.admission.admission import AdmissionController, AdmissionSettings
from upwash.core.admission.clients import Client
from upwash.core.admission.server import ServerOffer
from upwash.errors import GarbledReply, Refused
from upwash.ports import AnsweredCall, Instance, InstanceSpec, Link, Program, ignored
from upwash.real.instances.control import (
    Admitted,
    Answered,
    Called,
    FromInstance,
    InstanceFailed,
    Printed,
    Ready,
    ServiceEnded,
    line,
)
from upwash.real.instances.instance_control import InstanceControl
from upwash.real.instances.output import InstanceOutput
from upwash.rpc.protocol import (
    AVAILABILITY,
    HOLD,
    LEAVE,
    PREPARE,
    START,
    AvailabilityReply,
    AvailabilityRequest,
    DenyRequest,
    HoldReply,
    HoldRequest,
    LeaveReply,
    LeaveRequest,
    PrepareRequest,
    StartReply,
    StartRequest,
    StatusReply,
    StatusRequest,
    decode_reply,
    decode_request,
    resolve,
)
from upwash.server.daemon import EdgeServer

SPEC = InstanceSpec("s1", "test", Program(""), methods=frozenset({"work"}))
ESCAPE = "\x1b[2J\x9b31m\u202e\r\nall is well"
LEASE = {"drone": "heron", "certificate": "", "ends_in_s": 1.0}
SERVER = {"name": "s1", "slots": 1, "leases": [LEASE], "instances": []}
STATUS_REPLY = {"up_s": 1.0, "servers": [SERVER], "refusals": [], "certificates": []}
HONEST: dict[type[msgspec.Struct], dict[str, Any]] = {
    AvailabilityReply: {
        "available": True,
        "endpoints": {"detector": ":40000"},
        "lease_s": 30.0,
        "peers": ["s2"],
    },
    StartReply: {"endpoint": ":40000"},
    HoldReply: {"held": True},
    StatusReply: STATUS_REPLY,
}
HELD = {"server": "s1", "drone": "heron", "certificate": "", "services": [], "for_s": 1.0}
PREPARED = {"server": "s1", "peer": "s2", "services": [], "arrives_in_s": 1.0, "hold_s": 1.0}
REQUESTS: dict[type[msgspec.Struct], dict[str, Any]] = {
    AvailabilityRequest: {"server": "s1", "services": ["detector"]},
    StartRequest: {"server": "s1", "service": "detector"},
    LeaveRequest: {"server": "s1"},
    DenyRequest: {"server": "s1", "services": ["detector"]},
    PrepareRequest: PREPARED,
    HoldRequest: HELD,
    StatusRequest: {},
}

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
        host = AdmissionController({"s1": ServerOffer(frozenset())}, AdmissionSettings())
        daemon = EdgeServer(
            host, images={}, runtime=NoRuntime(), dialer=NoDialer(), drain_s=1.0, start_timeout_s=1.0
        )
        return await daemon.handle(path, body, Client("heron"))

    try:
        reply = asyncio.run(ask())
    except Refused:
        return
    assert isinstance(msgspec.msgpack.decode(reply), dict)


@pytest.mark.parametrize("expected", [AvailabilityReply, StartReply, LeaveReply, HoldReply, StatusReply])
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
            Answered(drone="heron", method="work", queued_s=0.1, took_s=0.1),
            Called("heron"),
            ServiceEnded(1),
            InstanceFailed("why"),
            Ready(":1"),
            Printed(b"words"),
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
        control = InstanceControl(
            SPEC,
            InstanceOutput("test@s1"),
            called=called.append,
            answered=ignored,
            reports=reports,
            orders=Silent(),  # type: ignore[arg-type]
        )
        begin: Any = ServiceEnded(0)  # whatever it is told
        assert await control.begin(begin) == "127.0.0.1:1"
        async with asyncio.timeout(5.0):
            await control.ended()
        assert control.is_over
        assert control._listening is not None
        assert control._listening.exception() is None
        assert set(called) <= {"heron"}

    asyncio.run(hear())


def test_an_instance_is_believed_only_what_can_be_so() -> None:
    async def hear() -> None:
        reports = asyncio.StreamReader()
        reports.feed_data(line(Ready("127.0.0.1:1")))
        called: list[str] = []
        answered: list[AnsweredCall] = []
        control = InstanceControl(
            SPEC,
            InstanceOutput("test@s1"),
            called=called.append,
            answered=answered.append,
            reports=reports,
            orders=Silent(),  # type: ignore[arg-type]
        )
        begin: Any = ServiceEnded(0)  # whatever it is told
        await control.begin(begin)
        admitting = asyncio.create_task(control.admit(frozenset({"heron"})))
        await asyncio.sleep(0)
        said: list[FromInstance] = [
            Admitted(),
            Called("stork"),
            Called("heron"),
            Answered(drone="heron", method="work", queued_s=0.0, took_s=0.0),
            Answered(drone="heron", method="rest", queued_s=0.0, took_s=0.0),
            Answered(drone="stork", method="work", queued_s=0.0, took_s=0.0),
        ]
        said += [
            Answered(drone="heron", method="work", queued_s=queued_s, took_s=took_s)
            for queued_s, took_s in itertools.permutations((0.0, -1.0, 1e300), 2)
        ]
        reports.feed_data(b"".join(map(line, said)))
        reports.feed_eof()
        await admitting
        await control.ended()
        assert called == ["heron"]
        assert answered == [AnsweredCall("heron", "work", 0.0, 0.0)]

    asyncio.run(hear())


class Silent:
    """The end of the line that the instance would read."""

    def write(self, _: bytes) -> None:
        """Nobody reads it."""

    @property
    def transport(self) -> Silent:
        """What is beneath it."""
        return self

    def abort(self) -> None:
        """It is gone."""


TOO_MANY = 256


@pytest.mark.parametrize(
    ("expected", "fields"),
    [
        (AvailabilityReply, {"reason": "x" * 1001}),
        (AvailabilityReply, {"reason": "\x1b" * 300}),
        (AvailabilityReply, {"endpoints": {f"s{number}": ":1" for number in range(TOO_MANY)}}),
        (AvailabilityReply, {"endpoints": {"x" * 256: ":1"}}),
        (AvailabilityReply, {"endpoints": {"detector": "x" * 256}}),
        (AvailabilityReply, {"peers": ["s2"] * TOO_MANY}),
        (AvailabilityReply, {"peers": ["x" * 256]}),
        *(
            (AvailabilityReply, {"lease_s": lease_s})
            for lease_s in (0.0, -1.0, 1e-9, 1.99, 1e300, inf, -inf, nan)
        ),
        *((AvailabilityReply, {"waiting": waiting}) for waiting in (-1, 65_536)),
        (StartReply, {"endpoint": "x" * 256}),
        (StartReply, {"reason": "x" * 1001}),
        *((StartReply, {"pause_s": pause_s}) for pause_s in (-1e-9, 86_400.1, inf, nan)),
        (HoldReply, {"held": False, "reason": "x" * 1001}),
        (StatusReply, {"up_s": nan}),
        (StatusReply, {"up_s": 1.0, "servers": [SERVER | {"leases": [LEASE | {"ends_in_s": inf}]}]}),
        (StatusReply, {"closing": "x" * 1001}),
        (StatusReply, {"certificates": [{"holder": "s1", "expires": "2030-01-01T00:00:00"}]}),
    ],
)
def test_a_reply_that_breaks_a_bound_is_none(expected: type[msgspec.Struct], fields: dict[str, Any]) -> None:
    honest = HONEST[expected]
    assert isinstance(decode_reply(msgspec.msgpack.encode(honest), expected, sender="s1"), expected)
    with pytest.raises(GarbledReply, match=r"^s1 sent a reply that cannot be decoded"):
        decode_reply(msgspec.msgpack.encode({**honest, **fields}), expected, sender="s1")


@pytest.mark.parametrize(
    ("expected", "fields"),
    [
        *((AvailabilityReply, {"lease_s": lease_s}) for lease_s in (2.0, 86_400.0)),
        *((AvailabilityReply, {"waiting": waiting}) for waiting in (0, 65_535)),
        (AvailabilityReply, {"reason": "x" * 1000}),
        (AvailabilityReply, {"peers": ["x" * 255] * 255}),
        (AvailabilityReply, {"endpoints": {f"{number:255}": "x" * 255 for number in range(255)}}),
        *((StartReply, {"pause_s": pause_s}) for pause_s in (0.0, 86_400.0)),
        (StatusReply, {"up_s": 1e10}),
    ],
)
def test_a_reply_may_reach_its_bounds(expected: type[msgspec.Struct], fields: dict[str, Any]) -> None:
    reply = decode_reply(msgspec.msgpack.encode(HONEST[expected] | fields), expected, sender="s1")
    assert {name: getattr(reply, name) for name in fields} == fields


def test_no_text_of_a_reply_reaches_anybody_with_control_characters() -> None:
    status = STATUS_REPLY | {
        "servers": [SERVER | {"name": ESCAPE, "leases": [LEASE | {"drone": ESCAPE, "certificate": ESCAPE}]}],
        "refusals": [{"server": ESCAPE, "client": ESCAPE, "why": ESCAPE, "times": 1, "ago_s": 1.0}],
    }
    decoded = decode_reply(msgspec.msgpack.encode(status), StatusReply, sender="s1")
    assert repr(decoded).isprintable()
    refused = {
        "available": False,
        "reason": ESCAPE,
        "peers": [ESCAPE],
        "endpoints": {ESCAPE: ESCAPE},
        ESCAPE: 1,
    }
    answer = decode_reply(msgspec.msgpack.encode(refused), AvailabilityReply, sender="s1")
    shown = "\\x1b[2J\\x9b31m\\u202e\\r\\nall is well"
    assert (answer.reason, answer.peers, answer.endpoints) == (shown, [shown], {shown: shown})


@pytest.mark.parametrize(
    ("request_type", "fields"),
    [
        (AvailabilityRequest, {"server": "s1", "services": [], ESCAPE: 1}),
        (AvailabilityRequest, {"server": "s1", "services": ["x"] * TOO_MANY}),
        (StartRequest, {"server": "x" * 256, "service": "detector"}),
        *((PrepareRequest, PREPARED | {"hold_s": hold_s}) for hold_s in (nan, inf, -1.0, 1e300)),
        (HoldRequest, HELD | {"for_s": nan}),
    ],
)
def test_a_request_that_breaks_a_bound_is_refused_in_print(
    request_type: type[msgspec.Struct], fields: dict[str, Any]
) -> None:
    with pytest.raises(Refused, match="undecodable request") as refused:
        decode_request(msgspec.msgpack.encode(fields), request_type)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 2000


@pytest.mark.parametrize("request_type", REQUESTS)
def test_a_request_with_a_field_that_the_daemon_does_not_know_is_refused(
    request_type: type[msgspec.Struct],
) -> None:
    fields = REQUESTS[request_type]
    assert isinstance(decode_request(msgspec.msgpack.encode(fields), request_type), request_type)
    with pytest.raises(Refused, match=r"undecodable request: .*unknown field `more`"):
        decode_request(msgspec.msgpack.encode(fields | {"more": 1}), request_type)


@pytest.mark.parametrize(
    ("endpoint", "daemon", "address"),
    [
        (":40000", "10.0.0.1:7070", "10.0.0.1:40000"),
        (":7072", "[fe80::1]:7070", "[fe80::1]:7072"),
        (":65535", "s1.local:7070", "s1.local:65535"),
        ("unix:/run/echo.sock", "unix:/run/daemon.sock", "unix:/run/echo.sock"),
        ("unix:/run/u-1/echo.sock", "unix:/run/daemon.sock", "unix:/run/u-1/echo.sock"),
    ],
)
def test_an_endpoint_is_a_port_of_the_daemons_host_or_a_socket_beside_its_own(
    endpoint: str, daemon: str, address: str
) -> None:
    assert resolve(endpoint, daemon) == address


@pytest.mark.parametrize(
    "endpoint",
    [
        "", ":", ":0", ":65536", ":99999", ":07", ":-1", ":1 ", ":1\n", ":\u0661", ":40000,10.0.0.2:1", "7072",
        "10.0.0.1:7072", "10.0.0.2:7072", "localhost:1", "dns:///evil:1", "ipv4:10.0.0.2:1", "ipv6:[::1]:1",
        "xds:///evil", "unix:/run/echo.sock", "unix-abstract:evil", "unix:///run/echo.sock", "vsock:1:1",
    ],
)  # fmt: skip
def test_a_server_does_not_say_which_host_is_called(endpoint: str) -> None:
    with pytest.raises(GarbledReply, match=r"daemon at 10\.0\.0\.1:7070 gave .* which is not its own"):
        resolve(endpoint, "10.0.0.1:7070")


@pytest.mark.parametrize(
    "endpoint",
    [
        ":1",
        "unix:/run/other/echo.sock",
        "unix:/run/u/../../echo.sock",
        "unix:/run/u",
        "unix-abstract:x",
        "dns:x:1",
    ],
)
def test_a_daemon_on_a_socket_gives_sockets_beside_it(endpoint: str) -> None:
    with pytest.raises(GarbledReply):
        resolve(endpoint, "unix:/run/u/daemon.sock")
