"""Datagrams to the `udpin` port of a drone that flies: `python -m tests.system.attacks.datagrams [NAME ...]`.

Prints what comes of a flight without an attack, and of one with each, of unsigned and of signed messages.
"""

from __future__ import annotations

import asyncio
import itertools
import sys

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.system.attacks.flown import HOME, KEY, LEGS, LOCAL, Attack, Stranger, Target, flown

from upwash.core.geo import LocalFrame
from upwash.mavlink.signing import Signing

HEARTBEAT_S, OFTEN_S = 0.02, 0.002
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


async def junk(_: Target, stranger: Stranger) -> None:
    """One byte that means nothing, again and again."""
    while True:
        stranger.send(b"\x00")
        await asyncio.sleep(OFTEN_S)


# --- a flood ------------------------------------------------------------------------------------------------


async def flood_of_bytes(target: Target, _: Stranger) -> None:
    """As many datagrams of one byte as one process can send."""
    await _flood(target, b"\x00")


async def flood_of_beginnings(target: Target, _: Stranger) -> None:
    """As many as networks carry of what takes longest to read: beginnings of messages."""
    await _flood(target, b"\xfe\x00" * 700)


async def _flood(target: Target, datagram: bytes) -> None:
    flooding = await asyncio.create_subprocess_exec(
        sys.executable, "-c", _SEND, LOCAL, str(target.port), datagram.hex()
    )
    try:
        await flooding.wait()
    finally:
        flooding.kill()
        await flooding.wait()


# --- in the vehicle's name, from another port ---------------------------------------------------------------


def heartbeat(autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA) -> mavlink.MAVLink_heartbeat_message:
    """Of a vehicle that is flown by its pilot."""
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR,
        autopilot,
        base_mode=mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED,
        custom_mode=mavlink.COPTER_MODE_LOITER,
        system_status=mavlink.MAV_STATE_ACTIVE,
        mavlink_version=3,
    )


async def of_nothing_known(_: Target, stranger: Stranger) -> None:
    """From before the vehicle is heard: heartbeats of an autopilot that cannot be flown."""
    while True:
        stranger.say(heartbeat(mavlink.MAV_AUTOPILOT_GENERIC), system=66)
        await asyncio.sleep(HEARTBEAT_S)


async def of_a_pilot(target: Target, stranger: Stranger) -> None:
    """Once the drone has found its vehicle: a pilot's mode, with all sequence numbers."""
    await target.router.answered.wait()
    await before_the_vehicles(target, stranger)


async def before_the_vehicles(_: Target, stranger: Stranger) -> None:
    """The same, from before the vehicle is heard."""
    while True:
        stranger.say(heartbeat(), ahead=20)
        await asyncio.sleep(HEARTBEAT_S)


async def at_waypoints(target: Target, stranger: Stranger) -> None:
    """Once the drone has found its vehicle: positions at each of the waypoints."""
    await target.router.answered.wait()
    for count, place in enumerate(itertools.cycle(LEGS)):
        geo = LocalFrame(HOME).geo(place)
        altitude_mm = round(place.altitude_m * 1e3)
        latitude, longitude = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
        time_ms = 100_000 + round(count * OFTEN_S * 1e3)
        position = mavlink.MAVLink_global_position_int_message(
            time_ms, latitude, longitude, altitude_mm, altitude_mm, 0, 0, 0, 0
        )
        stranger.say(position, ahead=20)
        await asyncio.sleep(OFTEN_S)


# --- from the vehicle's own address -------------------------------------------------------------------------


async def forged(target: Target, _: Stranger) -> None:
    """Unsigned heartbeats of a pilot's mode."""
    await _forge(target, None)


async def of_another_key(target: Target, _: Stranger) -> None:
    """The same, signed with another key, with the latest time that there is."""
    await _forge(target, Signing(bytes(32), kept=2**48 - 10**6))


async def _forge(target: Target, signing: Signing | None) -> None:
    await target.router.answered.wait()
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    while True:
        message = heartbeat()
        target.router.send(signing.pack(message, codec) if signing else bytes(message.pack(codec)))
        codec.seq = (codec.seq + 21) % 256
        await asyncio.sleep(OFTEN_S)


async def replayed(target: Target, _: Stranger) -> None:
    """All that the vehicle said in the last seconds, again and again: it stood still then, in another mode."""
    await target.router.answered.wait()
    while True:
        for packet in target.router.passed[-100::2]:
            target.router.send(packet)
            await asyncio.sleep(OFTEN_S)


ATTACKS: dict[str, Attack] = {
    each.__name__: each
    for each in (
        *(junk, flood_of_bytes, flood_of_beginnings, of_nothing_known, of_a_pilot, before_the_vehicles),
        *(at_waypoints, forged, of_another_key, replayed),
    )
}


def main(*names: str) -> None:
    """Prints what comes of each flight."""
    for signed in (None, KEY):
        for name in ("nobody", *(names or ATTACKS)):
            outcome = asyncio.run(flown(ATTACKS.get(name), key=signed))
            print(
                f"{name}{', signed' if signed else ''}: {outcome.ended}; "
                f"{outcome.astray} datagrams of the drone's went to the stranger; "
                f"{outcome.off_m:.1f} m off at a waypoint"
            )
            for fault in outcome.faults:
                print(f"  fault: {fault}")


if __name__ == "__main__":
    main(*sys.argv[1:])
