"""As many datagrams of nonsense as one process can send to the drone's `udpin` port."""

from __future__ import annotations

import asyncio
import sys

from tests.system.attacks.flown import KEY, LOCAL, Stranger, Target, main

BEGINNINGS_OF_MESSAGES = b"\xfe\x00" * 700  # what takes longest to read
_SEND = """
import socket, sys
flooding = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
flooding.connect((sys.argv[1], int(sys.argv[2])))
datagram = bytes.fromhex(sys.argv[3])
while True:
    try:
        flooding.send(datagram)
    except ConnectionRefusedError:
        pass
"""


async def of_bytes(target: Target, _: Stranger) -> None:
    """One byte each."""
    await _flood(target, b"\x00")


async def of_beginnings(target: Target, _: Stranger) -> None:
    """Each as long as networks carry."""
    await _flood(target, BEGINNINGS_OF_MESSAGES)


async def _flood(target: Target, datagram: bytes) -> None:
    flooding = await asyncio.create_subprocess_exec(
        sys.executable, "-c", _SEND, LOCAL, str(target.port), datagram.hex()
    )
    try:
        await flooding.wait()
    finally:
        flooding.kill()
        await flooding.wait()


if __name__ == "__main__":
    main(of_bytes, of_beginnings, key=KEY)
