"""A service whose calls stall now and then, and missions that call it: what bench/deadlines.py runs."""

from __future__ import annotations

import itertools
import os
import random
import time
from pathlib import Path

from upwash import Drone, service

CALL_S = (0.35, 0.45)  # the least and the most of a call that does not stall
STALL_S, STALLS_ONE_IN = 10.0, 20
LANES = 4  # a stalled call leaves room for others, so that calls stall independently of each other
PERIOD_S = 2.0
UNCOUNTED = 5  # calls, the first ones, while servers start their services
CALLS = "BENCH_CALLS"  # the environment variable with the number of counted calls
PHOTO = bytes(10_000)  # which TCP sends at once


def drawn_s(number: int, seed: int) -> float:
    """The time of the call with that number: the seed draws one stalling call of each twenty."""
    turn, place = divmod(number, STALLS_ONE_IN)
    is_stalled = random.Random(f"{seed}/{turn}").randrange(STALLS_ONE_IN) == place
    return STALL_S if is_stalled else random.Random(f"{seed}/{turn}/{place}").uniform(*CALL_S)


@service(concurrency=LANES)
class Stalling:
    """Without a seed its calls take no time of their own; with one, each adds the time of its begin to the file."""

    def __init__(self, seed: int = 0, file: str = "") -> None:
        self._seed, self._file = seed, Path(file)
        self._numbers = itertools.count()

    def look(self, photo: bytes) -> int:
        """The photo's length."""
        if self._seed:
            with self._file.open("a") as file:
                file.write(f"{time.monotonic()}\n")
            time.sleep(drawn_s(next(self._numbers), self._seed))
        return len(photo)


def survey(drone: Drone) -> None:
    """Makes a call at every waypoint."""
    stalling = drone.service(Stalling)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        stalling.look(PHOTO)
    drone.end_flight()
    drone.autopilot.disarm()


def on_the_ground(drone: Drone) -> None:
    """Makes the calls, each 2 s after the last one or at its end."""
    stalling = drone.service(Stalling)
    for _ in range(UNCOUNTED + int(os.environ[CALLS])):
        next_s = time.monotonic() + PERIOD_S
        stalling.look(PHOTO)
        time.sleep(max(0.0, next_s - time.monotonic()))
