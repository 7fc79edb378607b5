"""What can go wrong with the stand-in, and when."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from upwash.errors import UsageError


class FaultKind(StrEnum):
    """What is wrong."""

    LINK = "link"  # it hears nothing and says nothing; connections stay open
    GPS = "gps"  # its receiver has no fix: it cannot be armed, and lands where it flies by position
    GLITCH = "glitch"  # its receiver is off by 56 m to the north
    BATTERY = "battery"  # all but empty
    RADIO = "radio"  # the pilot's remote control is out of reach
    GROUND = "ground"  # no heartbeat of a ground station arrives
    COMPASS = "compass"  # its compass is not calibrated: it refuses to arm
    ARMING = "arming"  # it refuses to arm


@dataclass(frozen=True, slots=True)
class VehicleFault:
    """Something that is wrong from one time after boot to another, in seconds of the vehicle's clock."""

    kind: FaultKind
    begins_s: float = 0.0
    ends_s: float = math.inf

    def lasts(self, uptime_s: float) -> bool:
        """Whether it is wrong now."""
        return self.begins_s <= uptime_s < self.ends_s


class Condition:
    """What is wrong with a vehicle, by the time since it was switched on."""

    def __init__(self, faults: Iterable[VehicleFault], *, now_s: float) -> None:
        self.faults = list(faults)
        self._booted_s = now_s

    def uptime_s(self, now_s: float) -> float:
        """How long it has been switched on."""
        return now_s - self._booted_s

    def suffers(self, kind: FaultKind, now_s: float) -> bool:
        """Whether such a thing is wrong with it now."""
        return any(fault.kind is kind and fault.lasts(self.uptime_s(now_s)) for fault in self.faults)

    def fail(self, kind: FaultKind, now_s: float) -> None:
        """Something is wrong with it from now on."""
        self.faults.append(VehicleFault(kind, begins_s=self.uptime_s(now_s)))

    def mend(self, kind: FaultKind) -> None:
        """Nothing of that kind is wrong with it any more."""
        self.faults = [fault for fault in self.faults if fault.kind is not kind]


@dataclass(slots=True)
class Battery:
    """How full it is, from how long the motors have run."""

    percent: float
    drain_percent_s: float
    draining_since_s: float | None = None

    def left_percent(self, now_s: float) -> float:
        """How full it is."""
        used_s = 0.0 if self.draining_since_s is None else now_s - self.draining_since_s
        return max(0.0, self.percent - used_s * self.drain_percent_s)

    def stop(self, now_s: float) -> None:
        """The motors draw nothing more."""
        self.percent = self.left_percent(now_s)
        self.draining_since_s = None


def read_fault(text: str) -> VehicleFault:
    """The fault that is written as `KIND`, `KIND:FROM` or `KIND:FROM-TO`; UsageError if it is none."""
    name, _, times = text.partition(":")
    begin, _, end = times.partition("-")
    try:
        fault = VehicleFault(FaultKind(name), float(begin or 0), float(end or math.inf))
    except ValueError:
        fault = None
    if fault is None or not 0 <= fault.begins_s < fault.ends_s:
        kinds = ", ".join(FaultKind)
        raise UsageError(
            f'"{text}" is no fault; write one of {kinds}, with its time in seconds after boot if it does not '
            "last for ever, such as link:30 or gps:60-90"
        )
    return fault
