"""A wide-area link between the namespaces of a drone and of a server.

A loop carries packets between two TUN devices, as netem would, which few kernels have.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import os
import random
import struct
from collections.abc import AsyncIterator, Iterator

import msgspec

from upwash.emulation.namespaces import LinkEnd, command, enter, enter_handle, give_address, inside
from upwash.emulation.vehicles import on_a_loop

DRONE = LinkEnd("drone", "wan", "10.77.0.1")
SERVER = LinkEnd("server", "wan", "10.77.0.2")
ADDRESS = f"{SERVER.address}:7070"  # of the daemon
_TUNSETIFF = 0x400454CA
_TUN_WITHOUT_HEADER = 0x1001
_QUEUE_S = 1.0  # what a modem holds; more is dropped
_LONGEST_PACKET = 65_535


class Shape(msgspec.Struct, frozen=True, kw_only=True):
    """A link: its rate each way, the MTU of its ends, the largest packet carried, and the share lost."""

    round_trip_s: float
    rate_bit_s: float
    mtu: int = 1500
    largest_bytes: int = _LONGEST_PACKET
    loss: float = 0.0


@contextlib.contextmanager
def wan(shape: Shape, drone: LinkEnd = DRONE, server: LinkEnd = SERVER) -> Iterator[None]:
    """Joins both namespaces, which are there already, until the end of the block."""
    ends = (drone, server)
    outside = os.open("/proc/self/ns/net", os.O_RDONLY)
    devices: list[int] = []

    def open_devices() -> None:
        for end in ends:
            enter(end.namespace)
            devices.append(_device(end.device))
        enter_handle(outside)

    @contextlib.asynccontextmanager
    async def carrying() -> AsyncIterator[None]:
        for end in ends:
            give_address(end, prefix_bits=24)
            command(*inside(end.namespace), "ip", "link", "set", end.device, "mtu", str(shape.mtu))
        there, back = devices
        _carry(there, back, shape, random.Random(1))
        _carry(back, there, shape, random.Random(2))
        yield

    try:
        with on_a_loop(open_devices, carrying):
            yield
    finally:
        for device in (*devices, outside):
            os.close(device)


def _device(name: str) -> int:
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _TUN_WITHOUT_HEADER))
    return device


def _carry(source: int, destination: int, shape: Shape, chance: random.Random) -> None:
    """Has the running loop hand on what comes at one device to the other, in order, as the link would."""
    loop = asyncio.get_running_loop()
    free_s = 0.0  # when the last packet has left the sender

    def carry() -> None:
        nonlocal free_s
        with contextlib.suppress(BlockingIOError):
            packet = os.read(source, _LONGEST_PACKET)
            begins_s = max(loop.time(), free_s)
            queued_s = begins_s - loop.time()
            if len(packet) > shape.largest_bytes or queued_s > _QUEUE_S or chance.random() < shape.loss:
                return
            free_s = begins_s + 8 * len(packet) / shape.rate_bit_s
            loop.call_at(free_s + shape.round_trip_s / 2, _write, destination, packet)

    loop.add_reader(source, carry)


def _write(device: int, packet: bytes) -> None:
    with contextlib.suppress(OSError):  # the other end does not take it: one more packet is lost
        os.write(device, packet)
