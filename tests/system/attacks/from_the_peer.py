"""What somebody sends who can send with the vehicle's own address: forged messages, and signed ones once more."""

from __future__ import annotations

import asyncio

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.system.attacks.flown import KEY, Stranger, Target, main
from tests.system.attacks.forged_heartbeats import heartbeat

from upwash.mavlink.signing import Signing

EVERY_S = 0.002


async def forged(target: Target, _: Stranger) -> None:
    """Unsigned heartbeats of a pilot's mode."""
    await target.router.answered.wait()
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    while True:
        target.router.send(bytes(heartbeat().pack(codec)))
        codec.seq = (codec.seq + 21) % 256
        await asyncio.sleep(EVERY_S)


async def of_another_key(target: Target, _: Stranger) -> None:
    """The same, signed with another key, with the latest time that there is."""
    await target.router.answered.wait()
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    signing = Signing(bytes(32), kept=2**48 - 10**6)
    while True:
        target.router.send(signing.pack(heartbeat(), codec))
        codec.seq = (codec.seq + 21) % 256
        await asyncio.sleep(EVERY_S)


async def replayed(target: Target, _: Stranger) -> None:
    """All that the vehicle said in the last seconds, again and again: it stood still then, in another mode."""
    await target.router.answered.wait()
    while True:
        for packet in target.router.passed[-100::2]:
            target.router.send(packet)
            await asyncio.sleep(EVERY_S)


if __name__ == "__main__":
    main(forged, of_another_key, replayed, key=KEY)
