"""Fleets on rows that share one server, beside a model that knows its queue: `python -m bench.fleets_rows`.

Three, four, six and eight drones fly fields of rows side by side; the first field is the same for all, others are
drawn. The server computes calls in the order of their arrival. Answers have no demands, and calls do not fail.

The model shares no code with upwash. Its drones see the queue of the server. A free place takes the first photo of
the line that it answers before the other place gets to it. `--slots auto` has the server measure its slots.
"""

from __future__ import annotations

import math
import random
from collections import deque
from statistics import fmean
from typing import Any, NamedTuple

from bench.program import command_line

from upwash.eventlog.schema import CallFailedInRange
from upwash.lab.processes import in_processes
from upwash.lab.simulation import simulate_fleet

FLEETS, FIELDS, QUICK_FIELDS = (3, 4, 6, 8), 6, 1
STEP_S, TAKEOFF_S, LANDING_S, ACCELERATION_M_S2, CHECK_S, APART_S = 0.02, 10.0, 16.0, 1.5, 8.0, 2.0


class Field(NamedTuple):
    """Rows of spots, back and forth, the seconds of a photo on a drone and at the server, and the server's lanes."""

    every_m: float
    spots: int
    rows: int
    speed_m_s: float
    local_s: float
    call_s: float
    lanes: int = 1

    @property
    def row_m(self) -> float:
        """The length of a row."""
        return self.every_m * (self.spots - 1)

    def ends(self, drone: int) -> list[tuple[float, float]]:
        """The ends of the rows of a drone, in the order of its flight."""
        west_m, ends = drone * (self.row_m + self.every_m), []
        for row in range(self.rows):
            across = [(west_m, row * self.every_m), (west_m + self.row_m, row * self.every_m)]
            ends += across if row % 2 == 0 else across[::-1]
        return ends


def drawn(number: int) -> Field:
    """The field of that number."""
    if number == 0:
        return Field(15.0, 7, 5, 5.0, 9.0, 3.0)
    chance = random.Random(number)
    return Field(
        round(chance.uniform(10.0, 25.0), 1),
        chance.randint(5, 9),
        chance.randint(3, 6),
        chance.choice([4.0, 5.0, 6.0]),
        round(chance.uniform(4.0, 12.0), 1),
        round(chance.uniform(0.5, 4.0), 1),
        chance.choice([1, 1, 2]),
    )


def scenario(field: Field, drones: int, slots: int | str) -> dict[str, Any]:
    """The same as a scenario."""
    return {
        "mission": {
            "ground_speed_m_s": field.speed_m_s,
            "waypoints_m": field.ends(0),
            "photos": {"every_m": field.every_m},
        },
        "camera": {"photo_s": 0.0},
        "vehicle": {
            "acceleration_m_s2": ACCELERATION_M_S2,
            "takeoff_s": TAKEOFF_S,
            "return_and_land_s": LANDING_S,
        },
        "policy": {"name": "look-ahead"},
        "service": [
            {"name": "detector", "local_call_s": {"light": field.local_s / 2, "heavy": field.local_s}}
        ],
        "server": [
            {
                "name": "s1",
                "east_m": 0.0,
                "north_m": 0.0,
                "range_m": 5000.0,
                "check_s": CHECK_S,
                "check_running_s": CHECK_S / 2,
                "remote_call_s": {"light": field.call_s / 2, "heavy": field.call_s},
                "truth": {"slots": slots, "lanes": field.lanes},
            }
        ],
        "drone": [
            {"name": f"d{number}", "departs_s": APART_S * number, "waypoints_m": field.ends(number)}
            for number in range(drones)
        ],
    }


class Drone:
    """A drone of the model; times are of the fleet."""

    def __init__(self, field: Field, number: int) -> None:
        self.departs_s = APART_S * number
        self.photos = deque(self._photos_s(field))
        self.landed_s = math.inf
        self.line: deque[float] = deque()
        self.own_until_s: float | None = None
        self.sent = False  # a call to the server is open

    def _photos_s(self, field: Field) -> list[float]:
        """When each photo is there; then self.flown_s is the end of the way."""
        now_s, photos, here = self.departs_s + TAKEOFF_S, [], field.ends(0)[0]
        if here != (0.0, 0.0):
            raise ValueError("the way begins at home")
        for number, end in enumerate(field.ends(0)[1:]):
            length_m = math.dist(here, end)
            if number % 2 == 0:
                photos += [
                    now_s + reached_s(field.every_m * n, length_m, field.speed_m_s)
                    for n in range(field.spots)
                ]
            now_s += reached_s(length_m, length_m, field.speed_m_s)
            here = end
        self.flown_s = now_s
        return photos


def reached_s(at_m: float, length_m: float, speed_m_s: float) -> float:
    """When a leg from rest to rest passes a place."""
    top_m_s = min(speed_m_s, math.sqrt(length_m * ACCELERATION_M_S2))
    ramp_m, ramp_s = top_m_s**2 / (2 * ACCELERATION_M_S2), top_m_s / ACCELERATION_M_S2
    if at_m < ramp_m:
        return math.sqrt(2 * at_m / ACCELERATION_M_S2)
    if at_m <= length_m - ramp_m:
        return ramp_s + (at_m - ramp_m) / top_m_s
    return length_m / top_m_s + ramp_s - math.sqrt(2 * max(0.0, length_m - at_m) / ACCELERATION_M_S2)


class Model:
    """The rule, in steps of time; the queue of the server is known."""

    def __init__(self, field: Field, drones: int) -> None:
        self.field = field
        self.drones = [Drone(field, number) for number in range(drones)]
        self.now_s = 0.0
        self.waiting: deque[Drone] = deque()
        self.computed: list[tuple[float, Drone]] = []

    def flown_s(self) -> float:
        """The mean time of the missions."""
        while any(drone.landed_s == math.inf for drone in self.drones):
            self.now_s += STEP_S
            self.answer()
            for drone in self.drones:
                if drone.landed_s == math.inf:
                    self.go_on(drone)
        return fmean(drone.landed_s - drone.departs_s for drone in self.drones)

    def answer(self) -> None:
        """End the server's calls that are computed, and begin the next ones."""
        for call in [call for call in self.computed if call[0] <= self.now_s]:
            self.computed.remove(call)
            call[1].sent = False
        while self.waiting and len(self.computed) < self.field.lanes:
            self.computed.append((self.now_s + self.field.call_s, self.waiting.popleft()))

    def queue_s(self) -> float:
        """The seconds until a call that comes now is begun."""
        free_s = sorted(end_s - self.now_s for end_s, _ in self.computed)
        free_s = [0.0] * (self.field.lanes - len(free_s)) + free_s
        for _ in self.waiting:
            free_s = sorted([free_s[0] + self.field.call_s, *free_s[1:]])
        return free_s[0]

    def go_on(self, drone: Drone) -> None:
        """Take the photos that are there by now, and have free places take them."""
        while drone.photos and drone.photos[0] <= self.now_s:
            drone.line.append(drone.photos.popleft())
        if drone.own_until_s is not None and drone.own_until_s <= self.now_s:
            drone.own_until_s = None
        if not drone.sent and self.now_s >= drone.departs_s + CHECK_S:
            self.send(drone)
        if drone.own_until_s is None and (number := self.of_drone(drone)) is not None:
            del drone.line[number]
            drone.own_until_s = self.now_s + self.field.local_s
        is_open = drone.photos or drone.line or drone.sent or drone.own_until_s is not None
        if not is_open and self.now_s >= drone.flown_s:
            drone.landed_s = self.now_s + LANDING_S

    def send(self, drone: Drone) -> None:
        """Send the first photo that the server answers before the drone gets to it or is done with it."""
        answered_s = self.now_s + self.queue_s() + self.field.call_s
        own_s = self.now_s if drone.own_until_s is None else drone.own_until_s
        for number in range(len(drone.line)):
            own_s += self.field.local_s
            if answered_s < own_s:
                del drone.line[number]
                drone.sent = True
                self.waiting.append(drone)
                self.answer()
                return
        if not drone.line and drone.own_until_s is not None and answered_s < drone.own_until_s:
            drone.sent, drone.own_until_s = True, answered_s  # a copy of what the drone computes
            self.waiting.append(drone)
            self.answer()

    def of_drone(self, drone: Drone) -> int | None:
        """The number of the first photo that the drone answers before the server, which has one of its photos."""
        if not drone.sent:
            return 0 if drone.line else None
        ends_s = [end_s for end_s, whose in self.computed if whose is drone]
        before = next((number for number, whose in enumerate(self.waiting) if whose is drone), 0)
        at_s = ends_s[0] if ends_s else self.now_s + self.field.call_s * (before + 1) / self.field.lanes
        others_s = self.field.call_s * max(0, len(self.waiting) + len(self.computed) - 1) / self.field.lanes
        for number in range(len(drone.line)):
            at_s += others_s + self.field.call_s
            if self.now_s + self.field.local_s <= at_s:
                return number
        return None


def fly(flight: tuple[int, int, int | str]) -> tuple[int, int, float, float, int]:
    """The drones, the field, the mean seconds of the missions and of the model's, and the blacklistings."""
    number, drones, slots = flight
    field = drawn(number)
    fleet = simulate_fleet(scenario(field, drones, drones if slots == "all" else slots))
    failed = sum(
        isinstance(event, CallFailedInRange) for flown in fleet.drones.values() for event in flown.events
    )
    assert fleet.mean_s is not None
    return drones, number, fleet.mean_s, Model(field, drones).flown_s(), failed


def main() -> None:
    """Flies all fleets, and prints a line for each size."""
    program = command_line("fleets_rows", __doc__)
    program.add_argument("--slots", choices=["all", "auto"], default="all", help="of the server")
    options = program.parse_args()
    fields = range(QUICK_FIELDS if options.quick else FIELDS)
    flights = [(field, drones, options.slots) for drones in FLEETS for field in fields]
    with in_processes(fly, flights) as results:
        flown = sorted(results)
    for drones in FLEETS:
        times = [(took_s, model_s, failed) for count, _, took_s, model_s, failed in flown if count == drones]
        shares = [took_s / model_s for took_s, model_s, _ in times]
        print(
            f"{drones} drones: {times[0][0]:.1f} s, {times[0][1]:.1f} s in the model; {len(shares)} fields: "
            f"{fmean(shares):.3f} of the model in the mean, {max(shares):.3f} at most; "
            f"{sum(failed for *_, failed in times)} blacklistings"
        )


if __name__ == "__main__":
    main()
