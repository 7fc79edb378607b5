"""Addresses of this machine: sockets that listen there, and requests that mean this machine."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest

from upwash.support.addresses import lacks_zone, listening_at, names_this_machine


@pytest.mark.parametrize(
    ("host", "listens_at", "reached_at"),
    [
        ("127.0.0.1:9100", "127.0.0.1", "127.0.0.1"),
        ("127.0.0.1", "0.0.0.0", "127.0.0.1"),
        ("localhost:9100", "127.0.0.1", "127.0.0.1"),
        ("LocalHost.", "10.10.1.1", "10.10.1.1"),
        ("10.10.1.1:9100", "0.0.0.0", "10.10.1.1"),
        ("10.10.1.1:9100", "::", "::ffff:10.10.1.1"),
        ("Heron.field.example:9100", "heron.field.example", "10.10.1.1"),
        ("host.docker.internal:9100", "Host.Docker.Internal", "172.17.0.1"),
        ("[::1]:9100", "::1", "::1"),
        ("[fd00::7]", "::", "fd00::7"),
        ("[fe80::1]:9100", "::", "fe80::1%eth0"),
    ],
)
def test_an_address_of_this_machine_is_its_own(host: str, listens_at: str, reached_at: str) -> None:
    assert names_this_machine(host, known_as=[listens_at], reached_at=reached_at)


@pytest.mark.parametrize(
    "host",
    [
        "evil.example", "evil.example:9100", "127.0.0.1.evil.example", "localhost.evil.example", "evil-localhost",
        "10.10.1.2", "[::2]:9100", "", ":9100", "[", "]", "[]", "127.0.0.1@evil.example", "evil.example:127.0.0.1",
        "\u0660", "127.1", "0x7f000001",
    ],
)  # fmt: skip
def test_any_other_name_is_another_machines(host: str) -> None:
    assert not names_this_machine(host, known_as=["127.0.0.1"], reached_at="127.0.0.1")


@pytest.mark.parametrize("everywhere", ["*:0", ":0", "[::]:0"])
@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_no_host_or_a_star_is_every_address_of_this_computer(everywhere: str, host: str) -> None:
    with listening_at(everywhere) as listening:
        socket.create_connection((host, listening.getsockname()[1]), timeout=5.0).close()


@pytest.mark.parametrize(("one", "other"), [("127.0.0.1", "::1"), ("[::1]", "127.0.0.1")])
def test_one_address_is_no_other(one: str, other: str) -> None:
    with listening_at(f"{one}:0") as listening, pytest.raises(ConnectionRefusedError):
        socket.create_connection((other, listening.getsockname()[1]), timeout=5.0)


ZONE = """
ip link add v0 type veth peer name v1
ip address add fe80::77/64 dev v0 nodad
ip link set v0 up
exec "$1" -c '
from upwash.support.addresses import address_of, listening_at
with listening_at("[fe80::77%v0]:7070") as listening:
    print(address_of(listening))
'
"""


def test_a_socket_of_a_link_local_address_keeps_its_zone() -> None:
    command = ["unshare", "--user", "--map-root-user", "--net", "sh", "-ec", ZONE, "sh", sys.executable]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.stderr.startswith(("unshare: ", "sh: ", "RTNETLINK ")):
        pytest.skip(f"no interface can be made here: {done.stderr}")
    assert done.stdout == "[fe80::77%v0]:7070\n", done.stderr


@pytest.mark.parametrize(
    ("address", "lacks"),
    [
        ("[fe80::1]:7070", True),
        ("[fe80::1%eth0]:7070", False),
        ("[fd00::1]:7070", False),
        ("10.10.1.1:7070", False),
        ("heron.local:7070", False),
    ],
)
def test_only_a_link_local_address_needs_its_interface(address: str, lacks: bool) -> None:
    assert lacks_zone(address) is lacks
