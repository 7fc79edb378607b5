"""A stand-in of either autopilot: where it stands, its faults, its parameters and its battery."""

from __future__ import annotations

import math
import secrets
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from functools import partial
from typing import ClassVar

from upwash.core.geo import GeoPosition, LocalFrame, Position, Velocity, ground_distance_m
from upwash.errors import UsageError
from upwash.mavlink.version import Version
from upwash.support.text import number_of
from upwash.vehicle.body.parameters import ParameterTable

HOME = Position(0.0, 0.0)
GRAVITY_M_S2 = 9.8
_NO_VERSION = Version(0, 0)
_SERIAL_BITS = 64
_FARTHEST_M, _HIGHEST_M = 10_000.0, 1_000.0


class LandedState(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class FaultKind(StrEnum):
    """A fault that the stand-in can be given."""

    LINK = "link"  # it hears nothing and says nothing; connections stay open
    GPS = "gps"  # its receiver has no fix: it cannot be armed, and lands where it flies by position
    GLITCH = "glitch"  # its receiver is off by 56 m to the north
    BATTERY = "battery"  # all but empty
    SECOND_BATTERY = "second-battery"  # the second one is all but empty
    RADIO = "radio"  # the pilot's remote control is out of reach
    GROUND = "ground"  # no heartbeat of a ground station arrives
    COMPASS = "compass"  # its compass is not calibrated: it refuses to arm
    ARMING = "arming"  # it refuses to arm


@dataclass(frozen=True, slots=True)
class VehicleFault:
    """A fault that lasts from one time after boot to another, in seconds of the vehicle's clock."""

    kind: FaultKind
    begins_s: float = 0.0
    ends_s: float = math.inf

    def lasts(self, uptime_s: float) -> bool:
        """Whether the fault lasts at that time after boot."""
        return self.begins_s <= uptime_s < self.ends_s


@dataclass(frozen=True, slots=True)
class SecondBattery:
    """A battery beside the first one, when the stand-in is switched on."""

    percent: float = 100.0
    endurance_s: float = 1_200.0

    def __post_init__(self) -> None:
        if not (0 <= self.percent <= 100 and 0 < self.endurance_s < math.inf):
            raise UsageError(
                f"vehicle: the second battery has {self.percent:g} % for {self.endurance_s:g} s; give 0 to 100 %, "
                "and seconds above 0"
            )


@dataclass(frozen=True, slots=True)
class StandInSettings:
    """Where a stand-in stands, and its state when it is switched on."""

    home: GeoPosition
    home_altitude_m: float = 0.0  # above the sea
    armable_after_s: float = 0.0
    battery_percent: float = 100.0
    endurance_s: float = 1_200.0  # of a full battery with the motors running
    second_battery: SecondBattery | None = None
    version: Version = _NO_VERSION
    speedup: float = 1.0  # of its clock, against everyone else's
    parameters: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[VehicleFault, ...] = ()
    rally: tuple[GeoPosition, ...] = ()  # its rally points, with altitudes above home
    serial: int = field(default_factory=partial(secrets.randbits, _SERIAL_BITS))  # of its board; 0: none

    def __post_init__(self) -> None:
        for name in ("endurance_s", "speedup"):
            if not 0 < getattr(self, name) < math.inf:
                raise UsageError(f"vehicle: {name} is {getattr(self, name)}; give a number above 0")
        if not self.armable_after_s >= 0:
            raise UsageError(f"vehicle: armable_after_s is {self.armable_after_s}; give a number from 0 on")
        if not 0 <= self.battery_percent <= 100:
            raise UsageError(f"vehicle: battery_percent is {self.battery_percent}; give 0 to 100")
        if not 0 <= self.serial < 2**_SERIAL_BITS:
            raise UsageError(f"vehicle: serial is {self.serial}; give 0 to {2**_SERIAL_BITS - 1}")
        if not math.isfinite(self.home_altitude_m):
            raise UsageError(f"vehicle: home_altitude_m is {self.home_altitude_m}; give a number of metres")


class Multicopter(ABC):
    """A multicopter between two messages. It has no clock: the time comes with each question and command."""

    at_most_percent_in_fault: ClassVar[float]  # of the battery
    empty_v: ClassVar[float]
    full_v: ClassVar[float]

    def __init__(self, settings: StandInSettings, parameters: ParameterTable, *, now_s: float) -> None:
        self.settings = settings
        self.frame = LocalFrame(settings.home)
        self.parameters = parameters
        for name, value in settings.parameters.items():
            if not parameters.change(name, value):
                raise UsageError(
                    f"vehicle: version {settings.version} has no parameter {name}, or not with the value {value:g}"
                )
        self.rally = tuple(map(self.frame.position, settings.rally))
        self._booted_s = now_s
        self._faults = list(settings.faults)
        self._charge_percent = settings.battery_percent
        self._drains_since_s: float | None = None
        has_second = any(fault.kind is FaultKind.SECOND_BATTERY for fault in settings.faults)
        self._second = settings.second_battery or (SecondBattery() if has_second else None)

    # --- where it is ----------------------------------------------------------------------------------------

    def advance(self, now_s: float) -> None:  # noqa: B027 - nothing to do for a motion that is known in advance
        """Simulates the vehicle up to the time."""

    @abstractmethod
    def position(self, now_s: float) -> Position:
        """The position in m, relative to where the vehicle was switched on."""

    @abstractmethod
    def velocity(self, now_s: float) -> Velocity:
        """The velocity in m/s."""

    @abstractmethod
    def heading_deg(self, now_s: float) -> float:
        """The heading in degrees clockwise from north."""

    @abstractmethod
    def flying(self, now_s: float) -> bool:
        """Whether it is off the ground."""

    @abstractmethod
    def target(self, now_s: float) -> Position | None:
        """The place it flies to, if any."""

    @abstractmethod
    def landed_state(self, now_s: float) -> LandedState:
        """On the ground, in the air, or on the way between."""

    @abstractmethod
    def arm(self, now_s: float, *, forced: bool = False) -> Result:
        """Starts the motors, once the checks pass."""

    @abstractmethod
    def disarm(self, now_s: float, *, forced: bool = False) -> Result:
        """Stops the motors: on the ground only, unless forced, and then it falls."""

    @abstractmethod
    def has_origin(self, now_s: float) -> bool:
        """Whether it has an origin, without which it reports no position."""

    @abstractmethod
    def unix_s(self, now_s: float) -> float:
        """The time of day that its receiver tells, in seconds since 1970; 0 while it tells none."""

    # --- what is wrong with it ------------------------------------------------------------------------------

    def uptime_s(self, now_s: float) -> float:
        """Seconds since it was switched on."""
        return now_s - self._booted_s

    def suffers(self, kind: FaultKind, now_s: float) -> bool:
        """Whether a fault of that kind lasts now."""
        return any(fault.kind is kind and fault.lasts(self.uptime_s(now_s)) for fault in self._faults)

    def fail(self, kind: FaultKind, now_s: float) -> None:
        """Begins a fault."""
        self._faults.append(VehicleFault(kind, begins_s=self.uptime_s(now_s)))

    def mend(self, kind: FaultKind) -> None:
        """Ends all faults of that kind."""
        self._faults = [fault for fault in self._faults if fault.kind is not kind]

    def faults_since_s(self, now_s: float) -> dict[FaultKind, float]:
        """The kinds of the faults that last now, each with the time at which it began."""
        return {
            kind: self._booted_s + min(fault.begins_s for fault in self._faults if fault.kind is kind)
            for kind in {fault.kind for fault in self._faults if fault.lasts(self.uptime_s(now_s))}
        }

    # --- its battery ----------------------------------------------------------------------------------------

    def start_draining(self, now_s: float) -> None:
        """Lets the battery drain from now on; call this when the motors start."""
        self._charge_percent, self._drains_since_s = self.charge_percent(now_s), now_s

    def stop_draining(self, now_s: float) -> None:
        """Ends the drain of the battery; call this when the motors stop."""
        self._charge_percent, self._drains_since_s = self.charge_percent(now_s), None

    def charge_percent(self, now_s: float) -> float:
        """The charge of the battery in percent, without faults."""
        drains_s = 0.0 if self._drains_since_s is None else now_s - self._drains_since_s
        return max(0.0, self._charge_percent - drains_s * 100 / self.settings.endurance_s)

    def battery_percent(self, now_s: float) -> float:
        """The charge of the battery in percent as the vehicle reports it, with faults."""
        return self._at_most(self.charge_percent(now_s), FaultKind.BATTERY, now_s)

    def batteries_percent(self, now_s: float) -> tuple[float, ...]:
        """The charge of each battery in percent as the vehicle reports it, with faults."""
        first_percent = self.battery_percent(now_s)
        if self._second is None:
            return (first_percent,)
        used_s = (
            (self.settings.battery_percent - self.charge_percent(now_s)) / 100 * self.settings.endurance_s
        )
        percent = max(0.0, self._second.percent - 100 * used_s / self._second.endurance_s)
        return first_percent, self._at_most(percent, FaultKind.SECOND_BATTERY, now_s)

    def main_percent(self, now_s: float) -> float:
        """The charge in SYS_STATUS: that of the first battery."""
        return self.battery_percent(now_s)

    def _at_most(self, charge_percent: float, fault: FaultKind, now_s: float) -> float:
        return min(charge_percent, self.at_most_percent_in_fault if self.suffers(fault, now_s) else 100.0)

    def battery_level(self, _now_s: float) -> int:
        """MAV_BATTERY_CHARGE_STATE; 0 where it is not reported."""
        return 0

    def battery_v(self, now_s: float, *, number: int = 0) -> float:
        """The voltage of a battery; the first one is number 0."""
        return self.empty_v + (self.full_v - self.empty_v) * self.batteries_percent(now_s)[number] / 100


def is_sensible(target: Position, *, lowest_m: float = 0.0) -> bool:
    """Whether a copter could be sent there; False for NaN."""
    near = ground_distance_m(target, HOME) <= _FARTHEST_M
    return near and lowest_m <= target.altitude_m <= _HIGHEST_M


def read_fault(text: str) -> VehicleFault:
    """The fault in `KIND`, `KIND:FROM` or `KIND:FROM-TO`; UsageError for any other text."""
    name, _, times = text.partition(":")
    begin, _, end = times.partition("-")
    try:
        fault = VehicleFault(FaultKind(name), number_of(begin or "0"), number_of(end) if end else math.inf)
    except ValueError:
        fault = None
    if fault is None or not 0 <= fault.begins_s < fault.ends_s:
        kinds = ", ".join(FaultKind)
        raise UsageError(
            f'"{text}" is no fault; write one of {kinds}, with its time in seconds after boot if it does not '
            "last for ever, such as link:30 or gps:60-90"
        )
    return fault
