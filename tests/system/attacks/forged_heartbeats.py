"""Heartbeats of a pilot's mode in the vehicle's name, and of an autopilot that is none, from another port."""

from __future__ import annotations

import asyncio

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.system.attacks.flown import KEY, Stranger, Target, main

EVERY_S = 0.02


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
    """From before the vehicle is heard: an autopilot that cannot be flown."""
    while True:
        stranger.say(heartbeat(mavlink.MAV_AUTOPILOT_GENERIC), system=66)
        await asyncio.sleep(EVERY_S)


async def of_a_pilot(target: Target, stranger: Stranger) -> None:
    """Once the drone has found its vehicle: in its name, with all sequence numbers."""
    await target.router.answered.wait()
    while True:
        stranger.say(heartbeat(), ahead=20)
        await asyncio.sleep(EVERY_S)


async def before_the_vehicles(_: Target, stranger: Stranger) -> None:
    """In its name, from before it is heard."""
    while True:
        stranger.say(heartbeat(), ahead=20)
        await asyncio.sleep(EVERY_S)


if __name__ == "__main__":
    main(of_nothing_known, of_a_pilot, before_the_vehicles, key=KEY)
