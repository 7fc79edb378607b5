"""Sockets that listen where a configuration says."""

from __future__ import annotations

import socket

import pytest

from upwash.support.listening import listening_at


@pytest.mark.parametrize("everywhere", ["*:0", ":0", "[::]:0"])
@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_no_host_or_a_star_is_every_address_of_this_computer(everywhere: str, host: str) -> None:
    with listening_at(everywhere) as listening:
        socket.create_connection((host, listening.getsockname()[1]), timeout=5.0).close()


@pytest.mark.parametrize(("one", "other"), [("127.0.0.1", "::1"), ("[::1]", "127.0.0.1")])
def test_one_address_is_no_other(one: str, other: str) -> None:
    with listening_at(f"{one}:0") as listening, pytest.raises(ConnectionRefusedError):
        socket.create_connection((other, listening.getsockname()[1]), timeout=5.0)
