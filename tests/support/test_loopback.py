"""Whose a connection over loopback is, as the system tells."""

from __future__ import annotations

import os
import socket

import pytest

from upwash.support.loopback import user_of


@pytest.mark.parametrize("host", ["127.0.0.1", "::ffff:127.0.0.1"])
def test_a_connection_is_of_the_user_who_made_it(host: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = server.getsockname()
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.socket(family) as client:
            try:
                client.connect((host, address[1]))
            except OSError as error:
                pytest.skip(f"no IPv6 here: {error}")
            made, peer = server.accept()
            with made:
                assert user_of(peer, address) == os.getuid()
                assert user_of((peer[0], peer[1] ^ 1), address) is None
