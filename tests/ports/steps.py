"""Steps of a flight that many tests of autopilots begin with."""

from __future__ import annotations

from upwash.ports import Autopilot


async def claim_and_arm(autopilot: Autopilot) -> None:
    """As a flight does it: the vehicle is the program's from before the wait for its checks."""
    await autopilot.claim(resumes=False)
    await autopilot.ready()
    await autopilot.arm()


async def take_off(autopilot: Autopilot, altitude_m: float = 5.0) -> None:
    await claim_and_arm(autopilot)
    await autopilot.takeoff(altitude_m)
