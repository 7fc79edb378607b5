"""What clients of a small HTTP server can hold, and for how long, whatever they send or do not read."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from upwash.support import http
from upwash.support.background import beside
from upwash.support.http import HttpServer

CLOSING = {"Connection": "close"}
ASKED = b"GET / HTTP/1.1\r\nHost: here\r\n\r\n"
LONG = b"GET /long HTTP/1.1\r\nHost: here\r\n\r\n"
NEVER = b"GET /never HTTP/1.1\r\nHost: here\r\n\r\n"
BODY = b"x" * 2_000_000  # more than kernels hold for a connection
LIMIT = 64

Stream = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def application(scope: Any, receive: Any, send: Any) -> None:
    """Answers a long body at /long, a short one elsewhere, never at /never."""
    if scope["path"] == "/never":
        await receive()
        await receive()
    body = BODY if scope["path"] == "/long" else b"short"
    headers = [(b"content-length", b"%d" % len(body))]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": body})


class Served:
    """A server as its clients meet it."""

    def __init__(self, listener: socket.socket, headers: dict[str, str]) -> None:
        self._listener = listener
        self.server = HttpServer(application, headers=headers, goodbye_s=30)
        self._streams: list[asyncio.StreamWriter] = []

    def connections(self) -> int:
        return len(self.server.server_state.connections)

    async def opened(self, request: bytes = b"") -> Stream:
        """A connection that has sent this."""
        reader, writer = await asyncio.open_connection(*self._listener.getsockname())
        self._streams.append(writer)
        writer.write(request)
        await writer.drain()
        return reader, writer

    async def told(self, request: bytes) -> bytes:
        """All that a connection answers to this, to its end."""
        reader, _ = await self.opened(request)
        return await reader.read()

    def hang_up(self) -> None:
        for writer in self._streams:
            writer.transport.abort()


async def to_the_end(reader: asyncio.StreamReader) -> bytes:
    """What comes until the connection ends, well or badly."""
    try:
        return await reader.read()
    except ConnectionResetError:
        return b""


@asynccontextmanager
async def served(headers: dict[str, str]) -> AsyncIterator[Served]:
    listener = socket.create_server(("127.0.0.1", 0))
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2**16)
    at = Served(listener, headers)
    async with asyncio.timeout(25.0), asyncio.TaskGroup() as group:
        group.create_task(at.server.serve(sockets=[listener]))
        try:
            yield at
        finally:
            at.hang_up()
            at.server.should_exit = True


@pytest.mark.parametrize("headers", [CLOSING, {}], ids=["closing", "keeping"])
@pytest.mark.parametrize("begun", [b"", ASKED[:-2]], ids=["nothing", "half"])
async def test_a_request_that_is_not_whole_in_time_has_no_answer(
    monkeypatch: pytest.MonkeyPatch, headers: dict[str, str], begun: bytes
) -> None:
    monkeypatch.setattr(http, "_REQUEST_S", 0.05)
    async with served(headers) as at:
        assert await at.told(begun) == b""


async def test_a_second_request_has_no_more_time_however_it_drips(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http, "_REQUEST_S", 0.2)
    async with served({}) as at:
        reader, writer = await at.opened(ASKED)
        assert (await reader.readuntil(b"short")).startswith(b"HTTP/1.1 200 ")
        writer.write(ASKED[:-2])

        async def drip() -> None:
            while True:
                writer.write(b"a: b\r\n")
                await asyncio.sleep(0.02)

        async with beside(drip(), name="drops"):
            assert await to_the_end(reader) == b""


async def test_a_request_that_is_being_answered_may_take_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http, "_REQUEST_S", 0.05)
    async with served({}) as at:
        reader, _ = await at.opened(NEVER)
        assert await at.told(b"") == b""
        assert not reader.at_eof()
        assert at.connections() == 1


@pytest.mark.parametrize(("headers", "is_cut"), [(CLOSING, True), ({}, False)], ids=["closing", "keeping"])
async def test_the_last_answer_of_a_connection_is_given_up_where_nobody_reads_it(
    monkeypatch: pytest.MonkeyPatch, headers: dict[str, str], is_cut: bool
) -> None:
    monkeypatch.setattr(http, "_READING_S", 0.0)
    async with served(headers) as at:
        reader, _ = await at.opened(LONG)
        head = await reader.readuntil(b"\r\n\r\n")
        assert b"content-length: 2000000" in head.lower()
        if is_cut:
            assert len(await reader.read()) < len(BODY)
        else:
            assert await reader.readexactly(len(BODY)) == BODY


@pytest.mark.parametrize("tail", [b"", b"\r\n", b"a: b\r\n" * 200_000], ids=["open", "whole", "endless"])
async def test_a_request_has_a_largest_size_and_its_refusal_arrives(tail: bytes) -> None:
    head = ASKED[:-2] + b"a: b\r\n" * 10_000
    async with served(CLOSING) as at:
        reader, writer = await at.opened(head + tail)
        assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 400 ")
        writer.write_eof()
        assert await reader.read() == b""


async def test_a_request_of_fifteen_kilobytes_is_answered() -> None:
    async with served(CLOSING) as at:
        assert (await at.told(ASKED[:-2] + b"a: b\r\n" * 2_500 + b"\r\n")).startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize("request_", [NEVER, LONG, b""], ids=["asks", "does not read", "is silent"])
async def test_the_oldest_of_too_many_makes_room(request_: bytes) -> None:
    async with served(CLOSING) as at:
        oldest, *crowd = [(await at.opened(request_))[0] for _ in range(LIMIT)]
        assert b"short" in await at.told(ASKED)
        assert len(await to_the_end(oldest)) < len(BODY)
        assert at.connections() == len(crowd)


async def test_of_a_burst_as_many_stay_as_may() -> None:
    async with served(CLOSING) as at:
        await asyncio.gather(*[at.opened() for _ in range(3 * LIMIT)])
        assert b"short" in await at.told(ASKED)
        assert at.connections() == LIMIT - 1


async def test_malformed_requests_leave_nothing_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    chunked = b"POST / HTTP/1.1\r\nHost: here\r\nTransfer-Encoding: chunked\r\n\r\n"
    async with served(CLOSING) as at:
        for request in (
            b"\x16\x03\x01\r\n\r\n",
            ASKED + b"\x00",
            chunked + b"zz\r\n",
            b"GET /\xff HTTP/1.1\r\n\r\n",
        ):
            _, writer = await at.opened(request)
            writer.write_eof()
        assert b"short" in await at.told(ASKED)
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING] == []


async def test_the_end_waits_for_nobody_who_is_silent_or_does_not_read(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(http, "_READING_S", 1000.0)
    async with served(CLOSING) as at:
        reader, _ = await at.opened(LONG)
        await at.opened()
        await reader.readuntil(b"\r\n\r\n")
        assert at.connections() == 2
        at.server.should_exit = True
        while at.connections():  # noqa: ASYNC110 - uvicorn has no event of that
            await asyncio.sleep(0.01)
    assert caplog.text == ""
