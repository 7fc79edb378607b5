"""Positions in the vehicle's name, from another port: it stands at each of its waypoints."""

from __future__ import annotations

import asyncio
import itertools

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.system.attacks.flown import HOME, LEGS, Stranger, Target, main

from upwash.core.geo import LocalFrame

EVERY_S = 0.002


async def at_waypoints(target: Target, stranger: Stranger) -> None:
    """Once the drone has found its vehicle; never ends by itself."""
    await target.router.answered.wait()
    for count, place in enumerate(itertools.cycle(LEGS)):
        geo = LocalFrame(HOME).geo(place)
        position = mavlink.MAVLink_global_position_int_message(
            100_000 + round(count * EVERY_S * 1e3),
            round(geo.latitude_deg * 1e7),
            round(geo.longitude_deg * 1e7),
            round(place.altitude_m * 1e3),
            round(place.altitude_m * 1e3),
            0,
            0,
            0,
            0,
        )
        stranger.say(position, ahead=20)
        await asyncio.sleep(EVERY_S)


if __name__ == "__main__":
    main(at_waypoints)
