"""Offers metrics to Prometheus over HTTP, and answers probes, from a thread with an event loop of its own."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Mapping
from http import HTTPStatus
from types import MappingProxyType
from typing import Any, NamedTuple

from prometheus_client import CollectorRegistry
from prometheus_client.exposition import choose_encoder

from upwash.config.values import is_on_this_machine
from upwash.core.admission.limits import Allowance
from upwash.errors import UsageError
from upwash.support.addresses import listening_at, names_this_machine
from upwash.support.background import only_logged, thread
from upwash.support.http import HttpServer
from upwash.support.text import printable

_PATHS = ("/metrics", "/")
_HEADERS = {"Connection": "close", "X-Content-Type-Options": "nosniff"}
_GOODBYE_S = 1

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
    application = _Application(registry, questions, (host, *hosts))
    server = HttpServer(application, headers=_HEADERS, goodbye_s=_GOODBYE_S)

    def serve() -> None:
        with listener:
            asyncio.run(server.serve(sockets=[listener]))

    serving = thread(serve, name="metrics", failed=only_logged)
    serving.start()
    _log.info("metrics at http://%s/metrics", address)
    try:
        yield address
    finally:
        server.should_exit = True
        await asyncio.to_thread(serving.join)


class _Answer(NamedTuple):
    status: HTTPStatus
    body: bytes
    content_type: str = "text/plain; charset=utf-8"


def _plain(status: HTTPStatus, why: str = "") -> _Answer:
    return _Answer(status, f"{why or status.phrase}\n".encode())


class _Application:
    """Answers by ASGI."""

    def __init__(self, registry: CollectorRegistry, questions: Questions, hosts: Collection[str]) -> None:
        self._registry = registry
        self._questions = questions
        self._hosts = hosts
        self._warnings = Allowance(_WARNINGS_PER_S, at_once=1)

    async def __call__(
        self, scope: Mapping[str, Any], _: object, send: Callable[[Mapping[str, Any]], Awaitable[None]]
    ) -> None:
        status, body, content_type = self._answer(scope)
        headers = [(b"content-type", content_type.encode()), (b"content-length", b"%d" % len(body))]
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": body})

    def _answer(self, scope: Mapping[str, Any]) -> _Answer:
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        if b"host" not in headers:  # as HTTP/1.0 allows
            return _plain(HTTPStatus.BAD_REQUEST)
        host = printable(headers[b"host"], _LONGEST_NAME)
        if not names_this_machine(host, known_as=self._hosts, reached_at=scope["server"][0]):
            why = _OTHER_HOST.format(host=host)
            if self._warnings.take(1, now_s=time.monotonic()):
                _log.warning("refused a request: %s", why)
            return _plain(HTTPStatus.MISDIRECTED_REQUEST, why)
        if scope["method"] not in ("GET", "HEAD"):
            return _plain(HTTPStatus.METHOD_NOT_ALLOWED)
        path = scope["path"]
        if path in self._questions:
            is_so = self._questions[path]()
            return _plain(HTTPStatus.OK if is_so else HTTPStatus.SERVICE_UNAVAILABLE)
        if path not in _PATHS:
            return _plain(HTTPStatus.NOT_FOUND)
        encode, content_type = choose_encoder(headers.get(b"accept", ""))
        return _Answer(HTTPStatus.OK, encode(self._registry), content_type)
