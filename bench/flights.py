"""Flies the stand-in beside other flights of a real ArduCopter: legs at several speeds, changes on the way, returns.

Run from the repository: `python -m bench.flights`, a second. tests/vehicle/data says where the recorded figures come
from.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from pathlib import Path

from upwash.core.geo import GeoPosition, Position, distance_m
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.settings import CopterMode, VehicleSettings
from upwash.vehicle.body.copter import LandedState, Result

DATA = Path(__file__).parents[1] / "tests" / "vehicle" / "data"
SETTINGS = VehicleSettings(home=GeoPosition(39.3666, 22.9507), armable_after_s=0.0)
READ_S = 0.1
REACTION_S = 0.1  # from the command to the vehicle's last report at rest
LANDED_M = 0.001
LONGEST_S = 300.0


def rows(name: str) -> list[dict[str, str]]:
    """A table of recorded figures."""
    return list(csv.DictReader((DATA / name).read_text(encoding="utf-8").splitlines()))


OBSERVED = {row["quantity"]: float(row["value"]) for row in rows("flights.csv")}


class Flight:
    """A copter in the air, whose time passes by reading."""

    def __init__(self, altitude_m: float = 10.0, settings: VehicleSettings = SETTINGS) -> None:
        self.copter = Copter(settings, now_s=0.0)
        self.now_s = 1.0
        self.said: list[tuple[float, int, str]] = []
        self.copter.change_mode(self.now_s, CopterMode.GUIDED)
        assert self.copter.arm(self.now_s) is Result.ACCEPTED
        assert self.copter.take_off(self.now_s, altitude_m) is Result.ACCEPTED
        self.until(lambda: self.copter.landed_state(self.now_s) is LandedState.IN_AIR)
        self.wait(3.0)

    @property
    def place(self) -> Position:
        """Where it is."""
        return self.copter.position(self.now_s)

    def wait(self, duration_s: float) -> None:
        """Let the time pass."""
        end_s = self.now_s + duration_s
        self.until(lambda: self.now_s >= end_s - READ_S / 2)

    def until(self, happens: Callable[[], bool]) -> float:
        """How long it takes."""
        begun_s = self.now_s
        while not happens():
            assert self.now_s - begun_s < LONGEST_S
            self.now_s += READ_S
            self.copter.heading_deg(self.now_s)
            self.copter.notice(self.now_s)
            for text in self.copter.said():
                self.said.append((self.now_s, text.severity, text.words))
        return self.now_s - begun_s

    def fly(self, target: Position, *, at_m_s: float) -> float:
        """How long it takes until it counts as arrived there."""
        self.copter.steer(self.now_s, target)
        self.copter.change_speed(self.now_s, at_m_s)
        return self.until(lambda: self.arrived(target))

    def arrived(self, target: Position) -> bool:
        """Whether it is near the target, and slow."""
        return distance_m(self.place, target) <= 1.0 and self.speed_m_s < 0.5

    @property
    def speed_m_s(self) -> float:
        """How fast it is."""
        return self.copter.velocity(self.now_s).speed_m_s

    def until_landed(self) -> float:
        """How long it takes until it touches down."""
        return self.until(lambda: self.place.altitude_m < LANDED_M)


def overshoot_m(length_m: float, speed_m_s: float) -> float:
    """How far it flies beyond the end of a leg."""
    flight = Flight()
    flight.fly(Position(length_m, 0.0, 10.0), at_m_s=speed_m_s)
    farthest_m = 0.0
    for _ in range(100):
        flight.wait(READ_S)
        farthest_m = max(farthest_m, flight.place.east_m - length_m)
    return farthest_m


def leg_s(length_m: float, speed_m_s: float) -> float:
    """How long a leg from rest takes, after its first motion."""
    return Flight().fly(Position(length_m, 0.0, 10.0), at_m_s=speed_m_s) - REACTION_S


def hold_m() -> float:
    """The braking distance after a command at 4.9 m/s to stay."""
    flight = Flight()
    flight.copter.steer(flight.now_s, Position(60.0, 0.0, 10.0))
    flight.copter.change_speed(flight.now_s, 5.0)
    flight.until(lambda: flight.speed_m_s >= 4.9)
    here = flight.place
    flight.copter.steer(flight.now_s, here)
    flight.wait(2.5)
    return flight.place.east_m - here.east_m


def changed_speed_s() -> float:
    """How long a leg of 60 m takes at 5 m/s, after 4.9 s at 2.5 and after 10 s at 6 m/s."""
    flight, target = Flight(), Position(60.0, 0.0, 10.0)
    begun_s = flight.now_s
    flight.copter.steer(flight.now_s, target)
    for at_s, speed_m_s in (0.0, 5.0), (4.9, 2.5), (10.0, 6.0):
        flight.wait(begun_s + at_s - flight.now_s)
        flight.copter.change_speed(flight.now_s, speed_m_s)
    flight.until(lambda: flight.arrived(target))
    return flight.now_s - begun_s


def changed_target_s() -> float:
    """How long it takes from 6 m/s westwards to a target 32 m to the north and 10 m back."""
    flight = Flight()
    flight.fly(Position(60.0, 20.0, 10.0), at_m_s=6.0)
    flight.wait(10.0)
    flight.copter.steer(flight.now_s, Position(20.0, 20.0, 10.0))
    flight.wait(4.0)
    return flight.fly(Position(40.0, 50.0, 10.0), at_m_s=6.0)


def return_s(altitude_m: float, away_m: float) -> tuple[float, float]:
    """How long after the command to return it descends, and touches down."""
    flight = Flight(altitude_m)
    flight.fly(Position(0.0, away_m, altitude_m), at_m_s=5.0)
    flight.wait(10.0)
    flight.copter.change_mode(flight.now_s, CopterMode.RTL)
    begun_s = flight.now_s
    flight.until(lambda: flight.copter.landed_state(flight.now_s) is LandedState.LANDING)
    descends_s = flight.now_s - begun_s
    flight.until_landed()
    return descends_s, flight.now_s - begun_s


def measured() -> Iterator[tuple[str, float]]:
    """What the stand-in does, by the names of the recorded figures."""
    for length_m, speed_m_s in (20, 4), (20, 5), (30, 5), (40, 5), (60, 5), (40, 2.5), (60, 9):
        yield f"leg {length_m} m at {speed_m_s} m/s", leg_s(length_m, speed_m_s)
    for length_m, speed_m_s in (20, 5), (40, 2.5), (60, 5), (60, 9):
        yield f"overshoot of {length_m} m at {speed_m_s} m/s", overshoot_m(length_m, speed_m_s)
    yield "hold at 4.9 m/s runs on", hold_m()
    yield "leg 60 m at 5 then 2.5 then 6 m/s", changed_speed_s()
    yield "new target at right angles in flight", changed_target_s()
    for altitude_m, away_m in (10, 20), (10, 40), (10, 60), (15, 10):
        name = f"return from {altitude_m} m high and {away_m} m away"
        descends_s, lands_s = return_s(altitude_m, away_m)
        yield f"{name}: descends", descends_s
        yield f"{name}: touches down", lands_s


if __name__ == "__main__":
    print("| s or m | ArduCopter | stand-in | apart |")
    print("|---|---|---|---|")
    for quantity, value in measured():
        was = OBSERVED[quantity]
        print(f"| {quantity} | {was:.4g} | {value:.3g} | {(value / was - 1) * 100:+.1f} % |")
