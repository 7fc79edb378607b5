"""Keeps 1,200 connections open that say nothing: `python -m tests.system.attacks.silent_strangers PORT`."""

from __future__ import annotations

import resource
import selectors
import socket
import sys

STRANGERS = 1200


def main(port: str, *_others: str) -> None:
    """Says "attacking" once all are open; makes anew what is closed."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    open_ones = selectors.DefaultSelector()
    for _number in range(STRANGERS):
        _open(open_ones, int(port))
    print("attacking", flush=True)
    while True:
        for key, _event in open_ones.select():
            assert isinstance(key.fileobj, socket.socket)
            open_ones.unregister(key.fileobj)
            key.fileobj.close()
            _open(open_ones, int(port))


def _open(open_ones: selectors.BaseSelector, port: int) -> None:
    connection = socket.create_connection(("127.0.0.1", port), timeout=10.0)
    open_ones.register(connection, selectors.EVENT_READ)


if __name__ == "__main__":
    main(*sys.argv[1:])
