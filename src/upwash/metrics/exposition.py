"""Offers metrics over HTTP, as Prometheus fetches them."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, start_http_server

from upwash.config import is_on_this_machine
from upwash.errors import UsageError

_log = logging.getLogger("upwash.metrics")


@contextlib.asynccontextmanager
async def exposed(registry: CollectorRegistry, listen: str) -> AsyncIterator[str]:
    """Offers the registry's metrics at `host:port`, from threads of their own; yields the address that came of it.

    Raises UsageError where nothing can listen there.
    """
    if not is_on_this_machine(listen):
        _log.warning(
            "whoever reaches %s can read the metrics: nobody is asked for a certificate there", listen
        )
    host, _, port = listen.rpartition(":")
    try:
        server, _ = await asyncio.to_thread(start_http_server, int(port), host.strip("[]"), registry)
    except OSError as error:
        raise UsageError(
            f"metrics cannot be offered at {listen}: {error.strerror}; choose another address, or end who uses it"
        ) from error
    address = f"{host}:{server.server_port}"
    _log.info("metrics at http://%s/metrics", address)
    try:
        yield address
    finally:
        await asyncio.to_thread(_close, server)


def _close(server: WSGIServer) -> None:
    server.shutdown()
    server.server_close()
