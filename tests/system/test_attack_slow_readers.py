"""Nobody who is slow, as they ask nothing or read nothing, holds a thread of the metrics, or up who is not."""

from __future__ import annotations

import asyncio
import http.client
import socket
import threading
from contextlib import ExitStack, suppress

import pytest
from prometheus_client import CollectorRegistry, Gauge

from upwash.metrics.exposition import exposed

pytestmark = pytest.mark.system

SILENT, DEAF = 300, 100
SERIES, LETTERS = 100, 3_000  # so that an answer does not fit what a kernel holds for a connection


def fetch(address: str) -> tuple[int, str]:
    """The status and the answer of one honest request."""
    connection = http.client.HTTPConnection(address, timeout=10.0)
    connection.request("GET", "/metrics")
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


def crowd(address: str, held: ExitStack) -> None:
    """Connections that send nothing, and such as ask and never read."""
    host, _, port = address.rpartition(":")
    for number in range(SILENT + DEAF):
        connection = held.enter_context(socket.create_connection((host, int(port)), timeout=5.0))
        if number >= SILENT:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            with suppress(OSError):  # it was turned away
                connection.sendall(f"GET /metrics HTTP/1.1\r\nHost: {address}\r\n\r\n".encode())


def threads() -> int:
    """How many there are, but for those by which this program waits itself."""
    return sum(not thread.name.startswith("asyncio") for thread in threading.enumerate())


async def test_the_slow_hold_no_thread_and_nobody_up() -> None:
    registry = CollectorRegistry()
    gauge = Gauge("upwash_attacked", "For this attack", ["number"], registry=registry)
    for number in range(SERIES):
        gauge.labels(f"{number:0{LETTERS}}").set(number)
    async with exposed(registry, "127.0.0.1:0") as address:
        await asyncio.to_thread(fetch, address)
        before = threads()
        with ExitStack() as held:
            await asyncio.to_thread(crowd, address, held)
            status, text = await asyncio.to_thread(fetch, address)
            assert (status, text.count("\nupwash_attacked{")) == (200, SERIES)
            assert threads() <= before
