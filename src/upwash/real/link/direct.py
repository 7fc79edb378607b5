"""Calls between a program and an instance that it started, over a socket pair.

The pair needs no address and no file, and no other program can call. Messages are frames of MessagePack behind a
length of 4 bytes, big-endian. The instance's end is not trusted, as a service shares its process.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import IO

import msgspec

from upwash.core.admission.clients import Client
from upwash.errors import DeadlineExceeded, LinkError, Refused, Unreachable
from upwash.real.link.requests import Caller, Requests, too_large, words_for_caller
from upwash.real.link.streams import connected_pair, hang_up
from upwash.support.background import only_logged, start, thread
from upwash.support.text import printable

BESIDE_BYTES = 4096  # of a frame, beside the request or result in it
_LENGTH_BYTES = 4
_SEND_BYTES = 2**20  # room for a photo, or what the system allows
_LONGEST_REASON = 1000


class DirectRequest(msgspec.Struct, frozen=True, array_like=True, tag=1):
    """To the instance: answer this request of that drone."""

    number: int
    drone: str
    path: str
    body: bytes


class DirectCancel(msgspec.Struct, frozen=True, array_like=True, tag=2):
    """To the instance: nobody waits for the reply to the request of that number any more."""

    number: int


class DirectReply(msgspec.Struct, frozen=True, array_like=True, tag=1):
    """From the instance: the reply to the request of that number."""

    number: int
    body: bytes


class DirectRefusal(msgspec.Struct, frozen=True, array_like=True, tag=2):
    """From the instance: why the request of that number has no reply."""

    number: int
    why: str


_Reply = DirectReply | DirectRefusal
_to_instance = msgspec.msgpack.Decoder(DirectRequest | DirectCancel)
_from_instance: msgspec.msgpack.Decoder[_Reply] = msgspec.msgpack.Decoder(_Reply)
_encoder = msgspec.msgpack.Encoder()

Calls = tuple[asyncio.StreamReader, asyncio.StreamWriter]  # the program's end, before it is a link


def frame(message: msgspec.Struct) -> bytes:
    """The encoded message: its length, then MessagePack."""
    body = _encoder.encode(message)
    return len(body).to_bytes(_LENGTH_BYTES) + body


def read_frame(stream: IO[bytes], *, most_bytes: int) -> bytes:
    """The next frame's contents; raises EOFError at the end, and ValueError for a frame that is too long."""
    return _whole(stream, _length_of(_whole(stream, _LENGTH_BYTES), most_bytes))


def _whole(stream: IO[bytes], length: int) -> bytes:
    data = stream.read(length)
    if len(data) < length:
        raise EOFError("it hung up")
    return data


def _length_of(head: bytes, most_bytes: int) -> int:
    length = int.from_bytes(head)
    if length > most_bytes:
        raise ValueError(f"a frame of {length} bytes, at most {most_bytes} are read")
    return length


async def direct_pair() -> tuple[Calls, socket.socket]:
    """A new socket pair: the program's end as streams, and the instance's socket; raises OSError."""
    calls, theirs = await connected_pair(limit=_SEND_BYTES)
    for end in (calls[1].get_extra_info("socket"), theirs):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BYTES)
    return calls, theirs


class DirectListener:
    """The instance's end: answers requests, each in a thread of its own, until the program hangs up."""

    address = ""

    def __init__(self, connection: socket.socket, requests: Requests) -> None:
        self._connection = connection
        self._requests = requests
        self._workers = ThreadPoolExecutor(requests.concurrent, "upwash-request")
        self._writing = threading.Lock()
        self._waited_for: set[int] = set()

    def start(self) -> None:
        """Begins to answer requests."""
        thread(self._listen, name="direct calls", failed=lambda _: os._exit(1)).start()

    def stop(self, *, grace_s: float = 0.0) -> None:
        """Takes no more requests, and returns when those under way have ended; `grace_s` has no effect."""
        self._workers.shutdown(cancel_futures=True)

    def _listen(self) -> None:
        most_bytes = self._requests.max_message_bytes + BESIDE_BYTES
        with self._connection.makefile("rb") as coming, contextlib.suppress(OSError, EOFError, RuntimeError):
            while True:
                match _to_instance.decode(read_frame(coming, most_bytes=most_bytes)):
                    case DirectRequest() as request:
                        self._waited_for.add(request.number)
                        self._workers.submit(self._answer, request)
                    case DirectCancel(number):
                        self._waited_for.discard(number)
        self._waited_for.clear()

    def _answer(self, request: DirectRequest) -> None:
        number = request.number
        caller = Caller(Client(request.drone), lambda: None, lambda: number in self._waited_for)
        reply: _Reply
        try:
            answer = self._requests.answer(request.path, caller, lambda: request.body)
            reply = DirectReply(number, bytes(answer))
        except BaseException as error:  # noqa: BLE001 - a defect of the handler must not end the listener
            reply = DirectRefusal(number, words_for_caller(error))
        self._waited_for.discard(number)
        with self._writing, contextlib.suppress(OSError):  # the program has hung up
            self._connection.sendall(frame(reply))


class DirectLink:
    """The program's end, which sends requests; create it in a running event loop."""

    is_far = False

    def __init__(self, calls: Calls, *, peer: str, drone: str, max_message_bytes: int) -> None:
        self._replies, self._requests = calls
        self._peer = peer
        self._drone = drone
        self._max_message_bytes = max_message_bytes
        self._numbers = itertools.count()
        self._waiting: dict[int, asyncio.Future[_Reply | LinkError]] = {}
        self._over: LinkError | None = None
        self._listening = start(self._listen(), name="the replies of an instance", failed=only_logged)

    async def request(
        self, path: str, body: bytes, *, timeout_s: float, may_queue_s: float | None = None
    ) -> bytes:
        """Sends one request and returns its reply; raises LinkError. Cancelling it gives the request up."""
        del may_queue_s  # the drone's own instances have no calls of other drones
        if self._over is not None:
            raise self._over
        if len(body) > self._max_message_bytes:
            why = too_large("request", len(body), self._max_message_bytes, whose="the drone")
            raise Refused(f"{self._peer}: {why}")
        number = next(self._numbers)
        self._requests.write(frame(DirectRequest(number, self._drone, path, bytes(body))))
        match await self._reply(number, timeout_s):
            case DirectReply(_, bytes(reply)):
                return reply
            case DirectRefusal(_, why):
                raise Refused(f"{self._peer}: {printable(why, _LONGEST_REASON)}")
            case LinkError() as error:
                raise error

    async def close(self) -> None:
        """Closes the link; every request under way fails."""
        self._end("the link is closed")

    async def _reply(self, number: int, timeout_s: float) -> _Reply | LinkError:
        answered: asyncio.Future[_Reply | LinkError] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answered
        try:
            async with asyncio.timeout(timeout_s):
                return await answered
        except TimeoutError:
            raise DeadlineExceeded(f"{self._peer}: no answer within {timeout_s:.1f} s") from None
        finally:
            del self._waiting[number]
            if answered.cancelled() and self._over is None:
                self._requests.write(frame(DirectCancel(number)))

    async def _listen(self) -> None:
        why = "it hung up"
        try:
            while True:
                head = await self._replies.readexactly(_LENGTH_BYTES)
                length = _length_of(head, self._max_message_bytes + BESIDE_BYTES)
                reply = _from_instance.decode(await self._replies.readexactly(length))
                if answered := self._waiting.get(reply.number):
                    answered.set_result(reply)
        except (OSError, EOFError):
            pass
        except (ValueError, msgspec.MsgspecError) as error:
            why = f"what it said is no answer: {error}"
        finally:
            self._end(why)

    def _end(self, why: str) -> None:
        self._over = self._over or Unreachable(f"{self._peer}: {why}")
        hang_up(self._requests.transport)
        for answered in self._waiting.values():
            if not answered.done():
                answered.set_result(self._over)
