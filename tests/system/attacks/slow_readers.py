"""Connections that ask nothing, or read nothing: `python -m tests.system.attacks.slow_readers`.

Holds hundreds of them against the metrics of this very process, and prints how many threads it had before and
meanwhile, and how long an honest fetch took among them.
"""

from __future__ import annotations

import asyncio
import http.client
import socket
import sys
import threading
import time
from contextlib import ExitStack, suppress

from prometheus_client import CollectorRegistry, Gauge

from upwash.metrics.exposition import exposed

SILENT, DEAF = 300, 100
_SERIES = 2_000  # so that an answer does not fit what a kernel holds for a connection


def fetch(address: str, *, host: str | None = None) -> tuple[int, str]:
    """The status and the answer of one honest request."""
    connection = http.client.HTTPConnection(address, timeout=10.0)
    connection.request("GET", "/metrics", headers={"Host": host} if host else {})
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


def registry() -> CollectorRegistry:
    """Metrics that take some room."""
    found = CollectorRegistry()
    gauge = Gauge("upwash_attacked", "For this attack", ["number"], registry=found)
    for number in range(_SERIES):
        gauge.labels(f"{number:0100}").set(number)
    return found


def crowd(address: str, held: ExitStack) -> None:
    """Connections that send nothing, and such as ask and never read."""
    host, _, port = address.rpartition(":")
    for number in range(SILENT + DEAF):
        connection = held.enter_context(socket.create_connection((host, int(port)), timeout=5.0))
        if number >= SILENT:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            with suppress(OSError):  # it was turned away
                connection.sendall(f"GET /metrics HTTP/1.1\r\nHost: {address}\r\n\r\n".encode())


def _threads() -> int:
    """How many there are, but for those by which this program waits itself."""
    return sum(not thread.name.startswith("asyncio") for thread in threading.enumerate())


async def attack() -> tuple[int, int, float]:
    """The threads before and in the attack, and the seconds that an honest fetch took in it."""
    async with exposed(registry(), "127.0.0.1:0") as address:
        await asyncio.to_thread(fetch, address)
        before = _threads()
        with ExitStack() as held:
            await asyncio.to_thread(crowd, address, held)
            began_s = time.monotonic()
            status, text = await asyncio.to_thread(fetch, address)
            took_s = time.monotonic() - began_s
            assert (status, text.count("\nupwash_attacked{")) == (200, _SERIES)
            return before, _threads(), took_s


if __name__ == "__main__":
    before, meanwhile, took_s = asyncio.run(attack())
    sys.stdout.write(
        f"{SILENT} that ask nothing and {DEAF} that read nothing: {before} threads before, {meanwhile} meanwhile; "
        f"an honest fetch took {took_s:.2f} s\n"
    )
