"""Network namespaces, and the devices in them, by iproute2.

They are made inside the emulation's own enclosure, so that no name clashes with another program's.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from upwash.errors import UpwashError, UsageError

_CLONE_NEWNET = 0x40000000
_QUIET = (
    "echo 1 >/proc/sys/net/ipv6/conf/all/disable_ipv6; echo 1 >/proc/sys/net/ipv6/conf/default/disable_ipv6"
)


@dataclass(frozen=True, slots=True)
class LinkEnd:
    """One end of a link: a device in a namespace, and its address there."""

    namespace: str
    device: str
    address: str


def make_namespace(name: str) -> None:
    """Makes a network namespace with nothing but its loopback, which no frame leaves by itself."""
    command("ip", "netns", "add", name)
    make_quiet(name)
    command("ip", "-n", name, "link", "set", "lo", "up")


def make_quiet(name: str) -> None:
    """Stops the namespace's own frames: no router solicitations, no duplicate address detection."""
    command(*inside(name), "sh", "-c", _QUIET)


def inside(namespace: str) -> tuple[str, ...]:
    """The prefix of a command line that runs it inside a namespace."""
    return ("ip", "netns", "exec", namespace)


def enter(namespace: str) -> None:
    """Moves the calling thread into the namespace; sockets that it opens later belong there."""
    with Path("/run/netns", namespace).open("rb") as file:
        enter_handle(file.fileno())


def enter_handle(handle: int) -> None:
    """Moves the calling thread into the namespace of an open file handle."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.setns(handle, _CLONE_NEWNET) != 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))


def join_by_cable(one: LinkEnd, other: LinkEnd) -> None:
    """Makes a pair of virtual Ethernet devices that joins the two ends."""
    command(
        *("ip", "link", "add", one.device, "netns", one.namespace, "type", "veth"),
        *("peer", "name", other.device, "netns", other.namespace),
    )
    for end, peer in ((one, other), (other, one)):
        command(*_ip(end), "address", "add", end.address, "peer", peer.address, "dev", end.device)
        command(*_ip(end), "link", "set", end.device, "up")


def give_address(end: LinkEnd, *, prefix_bits: int) -> None:
    """Gives an existing device its address, and switches it on."""
    command(*_ip(end), "address", "add", f"{end.address}/{prefix_bits}", "dev", end.device)
    command(*_ip(end), "link", "set", end.device, "up")


def add_route(end: LinkEnd, subnet: str, *, via: str) -> None:
    """Routes packets of the end's namespace to the subnet through the end, via that address."""
    command(*_ip(end), "route", "add", subnet, "via", via, "dev", end.device)


def _ip(end: LinkEnd) -> tuple[str, ...]:
    return ("ip", "-n", end.namespace)


def require_tools(packages: Mapping[str, str]) -> None:
    """Raises UsageError if a program is missing, with the Debian packages of the missing programs."""
    missing = [program for program in packages if shutil.which(program) is None]
    if missing:
        named = ", ".join(dict.fromkeys(packages[program] for program in missing))
        raise UsageError(f"{', '.join(missing)} not found: install Debian's {named}")


def command(*words: str) -> str:
    """Runs a command and returns its output; raises UpwashError with its error output if it fails."""
    done = subprocess.run(  # noqa: S603
        words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise UpwashError(f"{' '.join(words)}: {done.stderr.strip() or f'ended with {done.returncode}'}")
    return done.stdout
