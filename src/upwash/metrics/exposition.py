"""Offers metrics to Prometheus over HTTP, and answers probes.

One thread answers on an event loop of its own: slow clients delay no other. Beyond
64 connections the oldest is closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import AsyncIterator, Callable, Collection, Mapping
from email.parser import BytesParser
from http import HTTPStatus
from types import MappingProxyType

from prometheus_client import CollectorRegistry
from prometheus_client.exposition import choose_encoder

from upwash.config import is_on_this_machine
from upwash.core.admission.limits import Allowance
from upwash.errors import UsageError
from upwash.support.addresses import listening_at, names_this_machine
from upwash.support.background import only_logged, thread
from upwash.support.text import printable

_PATHS = ("/metrics", "/")
_LARGEST_REQUEST_BYTES = 2**14
_REQUEST_S = 5.0  # for a request to be whole
_READING_S = 10.0  # for its answer to be read
_CONNECTIONS = 64

_LONGEST_NAME = 255
_WARNINGS_PER_S = 1 / 60
_OTHER_HOST = (
    'the request\'s Host is "{host}"; answered are localhost, the address at which this computer was reached, the '
    "host of `metrics` and the names of `metrics_hosts` in the configuration: add the name there"
)

_log = logging.getLogger("upwash.metrics")

Questions = Mapping[str, Callable[[], bool]]  # by path, each answered from another thread than the program's
NO_QUESTIONS: Questions = MappingProxyType({})


@contextlib.asynccontextmanager
async def exposed(
    registry: CollectorRegistry,
    listen: str,
    hosts: Collection[str] = (),
    *,
    questions: Questions = NO_QUESTIONS,
) -> AsyncIterator[str]:
    """Offers the registry's metrics at `host:port`, from a thread of its own; yields the address in use.

    A question is answered by status 200 for True, else 503. A request may name this machine by any of these further
    `hosts`. Raises UsageError if it cannot listen there.
    """
    if not is_on_this_machine(listen):
        _log.warning(
            "whoever reaches %s can read the metrics: nobody is asked for a certificate there", listen
        )
    try:
        listener = await asyncio.to_thread(listening_at, listen)
    except OSError as error:
        raise UsageError(
            f"metrics cannot be offered at {listen}: {error.strerror}; choose another address, or end who uses it"
        ) from error
    host = listen.rpartition(":")[0]
    address = f"{host}:{listener.getsockname()[1]}"
    server = _Server(registry, questions, listener, (host, *hosts))
    serving = thread(server.run, name="metrics", failed=only_logged)
    serving.start()
    _log.info("metrics at http://%s/metrics", address)
    try:
        yield address
    finally:
        server.stop()
        await asyncio.to_thread(serving.join)


class _Server:
    def __init__(
        self,
        registry: CollectorRegistry,
        questions: Questions,
        listener: socket.socket,
        hosts: Collection[str],
    ) -> None:
        self._registry = registry
        self._questions = questions
        self._listener = listener
        self._hosts = hosts
        self._warnings = Allowance(_WARNINGS_PER_S, at_once=1)
        self._loop = asyncio.new_event_loop()
        self._stopped = asyncio.Event()
        self._connections: dict[asyncio.Task[None], asyncio.StreamWriter] = {}  # oldest first

    def run(self) -> None:
        """Serves until it is stopped; to be the whole of a thread."""
        with contextlib.closing(self._loop), self._listener:
            self._loop.run_until_complete(self._serve())

    def stop(self) -> None:
        """Ends it, with every connection; from any thread."""
        with contextlib.suppress(RuntimeError):  # its loop was closed by a failure
            self._loop.call_soon_threadsafe(self._stopped.set)

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._admit, sock=self._listener, limit=_LARGEST_REQUEST_BYTES)
        async with server:
            await self._stopped.wait()
            server.close()
            for writer in self._connections.values():
                writer.transport.abort()
            await asyncio.gather(*self._connections, return_exceptions=True)

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None  # noqa: S101 - it runs in one
        if len(self._connections) >= _CONNECTIONS:
            next(iter(self._connections.values())).transport.abort()
        self._connections[task] = writer
        try:
            await self._converse(reader, writer)
        except (OSError, TimeoutError, asyncio.IncompleteReadError):
            pass  # it has gone, or is too slow
        finally:
            del self._connections[task]
            writer.transport.abort()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async with asyncio.timeout(_REQUEST_S):
            try:
                request = await reader.readuntil(b"\r\n\r\n")
            except asyncio.LimitOverrunError:
                request = b""
        writer.write(self._answer(request, reached_at=writer.get_extra_info("sockname")[0]))
        writer.write_eof()
        async with asyncio.timeout(_READING_S):
            await writer.drain()
            while await reader.read(_LARGEST_REQUEST_BYTES):  # until it has hung up, so that it has read all
                pass

    def _answer(self, request: bytes, *, reached_at: str) -> bytes:
        first, _, rest = request.partition(b"\r\n")
        match first.decode("latin-1").split(" "):
            case [method, target, "HTTP/1.0" | "HTTP/1.1"]:
                headers = BytesParser().parsebytes(rest, headersonly=True)
            case _:
                return _response(HTTPStatus.BAD_REQUEST)
        hosts = headers.get_all("Host", [])
        if len(hosts) != 1:
            return _response(HTTPStatus.BAD_REQUEST)
        host = printable(str(hosts[0]), _LONGEST_NAME)
        if not names_this_machine(host, known_as=self._hosts, reached_at=reached_at):
            why = _OTHER_HOST.format(host=host)
            if self._warnings.take(1, now_s=self._loop.time()):
                _log.warning("refused a request: %s", why)
            return _response(HTTPStatus.MISDIRECTED_REQUEST, f"{why}\n".encode())
        if method not in ("GET", "HEAD"):
            return _response(HTTPStatus.METHOD_NOT_ALLOWED)
        path, with_body = target.partition("?")[0], method == "GET"
        if path in self._questions:
            is_so = self._questions[path]()
            return _response(HTTPStatus.OK if is_so else HTTPStatus.SERVICE_UNAVAILABLE, with_body=with_body)
        if path not in _PATHS:
            return _response(HTTPStatus.NOT_FOUND)
        encode, content_type = choose_encoder(str(headers.get("Accept", "")))
        try:
            body = encode(self._registry)
        except Exception:  # noqa: BLE001 - whatever a collector raises is not the end of this
            _log.exception("the metrics cannot be told")
            return _response(HTTPStatus.INTERNAL_SERVER_ERROR)
        return _response(HTTPStatus.OK, body, content_type=content_type, with_body=with_body)


def _response(
    status: HTTPStatus,
    body: bytes | None = None,
    *,
    content_type: str = "text/plain; charset=utf-8",
    with_body: bool = True,
) -> bytes:
    if body is None:
        body = f"{status.phrase}\n".encode()
    head = (
        f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: {content_type}\r\n"
        f"Content-Length: {len(body)}\r\nX-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + (body if with_body else b"")
