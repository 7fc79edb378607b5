"""A mission that knows what each of its calls must answer, with photos of the size of real ones."""

from __future__ import annotations

import random
import zlib
from dataclasses import dataclass
from typing import Any

import msgspec

from upwash import Drone, service

CALLS = 2  # at each waypoint
PHOTO_BYTES = 430_000


class Blurred(Exception):
    """Nothing can be said about a photo."""


@dataclass(frozen=True)
class Sighting:
    """What is to be seen on the photo of that number."""

    number: int
    checksum: int


class Told(msgspec.Struct, frozen=True, kw_only=True):
    """What came of the call of that number, as the mission tells its user."""

    asked: int
    answer: Any = None
    raised: str = ""


@service
class Spotter:
    """Sums photos up, but for every fifth."""

    def look(self, number: int, photo: bytes) -> Sighting:
        if number % 5 == 2:
            raise Blurred(f"photo {number} is blurred")
        return Sighting(number, zlib.crc32(photo))


def look_around(drone: Drone) -> None:
    """Asks twice at each waypoint, each time about another photo."""
    spotter = drone.service(Spotter)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        for number in numbers_at(waypoint.index):
            drone.user.notify(heard(spotter, number), at=waypoint)
    drone.autopilot.land()  # not at home: that would take as long again
    drone.autopilot.disarm()


def numbers_at(waypoint: int) -> range:
    return range(CALLS * waypoint, CALLS * (waypoint + 1))


def heard(spotter: Spotter, number: int) -> Told:
    """What the service answers or raises about the photo of that number, wherever it runs."""
    photo = random.Random(number).randbytes(PHOTO_BYTES)
    try:
        answer = spotter.look(number, photo)
    except Blurred as error:
        return Told(asked=number, raised=repr(error))
    return Told(asked=number, answer=msgspec.to_builtins(answer))
