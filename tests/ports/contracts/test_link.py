"""What every Link does, with the same errors: the model on virtual time, and gRPC and socket pairs with listeners."""

from __future__ import annotations

import asyncio
import functools
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager
from pathlib import Path

import pytest

from upwash.core.admission.clients import Client
from upwash.errors import DeadlineExceeded, NotBegun, Refused, Unreachable
from upwash.ports import Link
from upwash.real.link.direct import DirectLink, DirectListener, direct_pair
from upwash.real.link.link import GrpcDialer
from upwash.real.link.listener import Listener
from upwash.real.link.requests import Caller, Requests
from upwash.rpc.service import Reduced, Reply, Request, with_queue
from upwash.sim.link import ModelDialer, Switchboard

PATH = "/upwash.test/any"
Hold = Callable[..., AbstractAsyncContextManager[Link]]


def queueing(body: bytes, may_queue_s: float | None, reply: bytes) -> bytes:
    """The reply of an instance that has 2.5 s of calls in its queue, and says so where it is asked."""
    match body:
        case b"queue":
            return with_queue(reply, queued_s=may_queue_s or 0.0, queue_s=2.5)
        case b"too long":
            raise NotBegun(2.5)
    return reply


@asynccontextmanager
async def model_link(folder: Path, *, answered: bool) -> AsyncIterator[Link]:
    async def answer(_path: str, body: bytes, client: Client) -> bytes:
        match body:
            case b"refuse":
                raise Refused("not today")
            case b"stuck":
                await asyncio.Event().wait()
        may_queue_s = body.may_queue_s if isinstance(body, Request) else None
        return queueing(body, may_queue_s, client.name.encode() + b" " + body)

    link = ModelDialer("heron", Switchboard({"s1": answer} if answered else {})).dial("s1", server="s1")
    yield link
    await link.close()


@contextmanager
def requests() -> Iterator[Requests]:
    """Answered by the name of who asks and what it said; what is stuck goes on at the end."""
    let_go = threading.Event()

    def answer(_path: str, body: bytes, caller: Caller) -> bytes:
        match body:
            case b"refuse":
                raise Refused("not today")
            case b"stuck":
                let_go.wait(10.0)
        return queueing(body, caller.may_queue_s, caller.client.name.encode() + b" " + body)

    try:
        yield Requests(answer, max_message_bytes=1000, concurrent=4, per_drone=4)
    finally:
        let_go.set()


@asynccontextmanager
async def grpc_link(folder: Path, *, answered: bool) -> AsyncIterator[Link]:
    address = f"unix:{folder}/s1.sock"
    with requests() as answering:
        listener = Listener(address, answering)
        if answered:
            listener.start()
        link = GrpcDialer("heron", None, max_message_bytes=1000).dial(address, server="s1")
        try:
            yield link
        finally:
            await link.close()
    await asyncio.to_thread(listener.stop)


@asynccontextmanager
async def direct_link(folder: Path, *, answered: bool) -> AsyncIterator[Link]:
    calls, theirs = await direct_pair()
    with requests() as answering, theirs:
        listener = DirectListener(theirs, answering)
        if answered:
            listener.start()
        else:
            theirs.close()
        link = DirectLink(calls, peer="s1 at its end", drone="heron", max_message_bytes=1000)
        try:
            yield link
        finally:
            await link.close()
    await asyncio.to_thread(listener.stop)


@pytest.fixture(
    params=[pytest.param(model_link, marks=pytest.mark.virtual), grpc_link, direct_link],
    ids=["model", "grpc", "direct"],
)
def hold(request: pytest.FixtureRequest, tmp_path: Path) -> Hold:
    """A link of each kind to a server, which answers or is not there."""
    return functools.partial(request.param, tmp_path)


@pytest.fixture
def link(hold: Hold) -> AbstractAsyncContextManager[Link]:
    """A link of each kind to a server that answers."""
    return hold(answered=True)


async def test_requests_get_their_replies_several_at_once(link: Link) -> None:
    asked = [link.request(PATH, Reduced(b"%d" % number), timeout_s=5.0) for number in range(4)]
    assert await asyncio.gather(*asked) == [b"heron %d" % number for number in range(4)]


async def test_a_refusal_comes_with_its_reason(link: Link) -> None:
    with pytest.raises(Refused, match=r"s1 at .*not today"):
        await link.request(PATH, b"refuse", timeout_s=5.0)
    assert await link.request(PATH, b"next", timeout_s=5.0) == b"heron next"


async def test_an_instance_hears_how_long_a_call_may_queue_and_tells_its_queue(hold: Hold) -> None:
    if "direct" in str(hold):
        pytest.skip("the drone's own instances have no calls of other drones")
    async with hold(answered=True) as link:
        reply = await link.request(PATH, b"queue", timeout_s=5.0, may_queue_s=1.5)
        assert isinstance(reply, Reply)
        assert (reply, reply.queued_s, reply.queue_s) == (b"heron queue", 1.5, 2.5)
        reduced = await link.request(PATH, Reduced(b"queue"), timeout_s=5.0, may_queue_s=0.25)
        assert isinstance(reduced, Reply) and reduced.queued_s == 0.25
        with pytest.raises(NotBegun, match=r"s1 at .* has 2\.5 s of calls in its queue") as told:
            await link.request(PATH, b"too long", timeout_s=5.0, may_queue_s=1.5)
        assert told.value.queue_s == 2.5


async def test_who_says_nothing_of_a_queue_has_none(link: Link) -> None:
    reply = await link.request(PATH, b"plain", timeout_s=5.0)
    assert reply == b"heron plain"
    assert not isinstance(reply, Reply) or (reply.queued_s, reply.queue_s) == (0.0, 0.0)


async def test_no_answer_within_the_deadline(link: Link) -> None:
    began_s = asyncio.get_running_loop().time()
    with pytest.raises(DeadlineExceeded, match=r"s1 at .*: no answer within 0\.2 s"):
        await link.request(PATH, b"stuck", timeout_s=0.2)
    assert 0.19 < asyncio.get_running_loop().time() - began_s < 2.0


async def test_nobody_there(hold: Hold) -> None:
    async with hold(answered=False) as link:
        with pytest.raises(Unreachable, match="s1 at "):
            await link.request(PATH, b"hello", timeout_s=5.0)


async def test_closing_breaks_requests_off_and_ends_the_link(link: Link) -> None:
    asked = asyncio.create_task(link.request(PATH, b"stuck", timeout_s=5.0))
    await asyncio.sleep(0.2)
    await link.close()
    with pytest.raises(Unreachable):
        await asked
    with pytest.raises(Unreachable, match="closed"):
        await link.request(PATH, b"hello", timeout_s=5.0)


async def test_a_request_that_is_cancelled_leaves_the_link_as_it_was(link: Link) -> None:
    asked = asyncio.create_task(link.request(PATH, b"stuck", timeout_s=5.0))
    await asyncio.sleep(0.1)
    asked.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asked
    assert await link.request(PATH, b"next", timeout_s=5.0) == b"heron next"


async def test_a_request_that_is_cancelled_as_its_link_closes_is_cancelled(link: Link) -> None:
    asked = asyncio.create_task(link.request(PATH, b"stuck", timeout_s=5.0))
    await asyncio.sleep(0.1)
    await link.close()
    asked.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asked
