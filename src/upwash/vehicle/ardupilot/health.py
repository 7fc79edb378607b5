"""What a stand-in ArduCopter knows of its own state: how far it has come up, what is wrong with it, where it is."""

from __future__ import annotations

import time

from upwash.vehicle.ardupilot.boot import EKF_FLIES_BY_GPS, EKF_HOLDS_STILL, Boot
from upwash.vehicle.ardupilot.failsafe import Failsafes
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.condition import Condition, FaultKind


class Health(Condition):
    """How well it is, by the time since it was switched on."""

    def __init__(self, settings: VehicleSettings, *, now_s: float) -> None:
        super().__init__(settings.faults, now_s=now_s)
        self.boot = Boot(settings.armable_after_s)
        self.failsafes = Failsafes(
            glitch_m=settings.glitch_m, glitch_cleared_s=settings.glitch_cleared_after_s
        )
        self._tells_time = settings.clock_offset_s is not None
        self._booted_unix_s = time.time() + (settings.clock_offset_s or 0.0)

    def unix_s(self, now_s: float) -> float:
        """The time of day that its receiver tells, in seconds since 1970; 0 while it tells none."""
        tells = self._tells_time and self.has_fix(now_s)
        return self._booted_unix_s + self.uptime_s(now_s) if tells else 0.0

    def booting(self, now_s: float) -> bool:
        """Whether it is not yet up."""
        return not self.boot.is_up(self.uptime_s(now_s))

    def has_fix(self, now_s: float) -> bool:
        """Whether its receiver knows where it is."""
        return self.hears_satellites(now_s) and not self.suffers(FaultKind.GPS, now_s)

    def hears_satellites(self, now_s: float) -> bool:
        """Whether its receiver is at work."""
        return self.boot.hears_satellites(self.uptime_s(now_s))

    def knows_its_place(self, now_s: float) -> bool:
        """Whether it has an origin to tell positions from."""
        self.look(now_s)
        return self.boot.places(self.uptime_s(now_s))

    def ekf_flags(self, now_s: float) -> int:
        """By what its estimate goes, as EKF_STATUS_REPORT tells it."""
        self.look(now_s)
        flags = self.boot.ekf_flags(self.uptime_s(now_s))
        return self.failsafes.ekf_flags if flags == EKF_FLIES_BY_GPS else min(flags, EKF_HOLDS_STILL)

    def lacks_place(self, now_s: float) -> bool:
        """Whether its position estimate is not good enough to fly by."""
        return self.failsafes.lost_place or not self.boot.estimates(self.uptime_s(now_s))

    def look(self, now_s: float) -> None:
        """Takes note of whether there is GPS now."""
        self.boot.look(self.uptime_s(now_s), gps=not self.suffers(FaultKind.GPS, now_s))

    def since_s(self, now_s: float) -> dict[FaultKind, float]:
        """What is wrong with it now, and since when."""
        return {
            kind: self._booted_s + min(fault.begins_s for fault in self.faults if fault.kind is kind)
            for kind in {fault.kind for fault in self.faults if fault.lasts(self.uptime_s(now_s))}
        }
