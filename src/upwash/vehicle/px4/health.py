"""What a stand-in PX4 knows of its own state: how long it is up, what is wrong with it, how full its battery is."""

from __future__ import annotations

from upwash.vehicle.body.condition import Condition, FaultKind
from upwash.vehicle.px4.parameters import Parameters
from upwash.vehicle.px4.settings import Px4Settings

_BOOT_S = 1.0
_FIRST_CHECKS_S = 2.0
_EMPTY_PERCENT = 6.0
_FULL_V, _EMPTY_V = 16.2, 14.4


class Health(Condition):
    """How well it is, by the time since it was switched on."""

    def __init__(self, settings: Px4Settings, parameters: Parameters, *, now_s: float) -> None:
        super().__init__(settings.faults, now_s=now_s)
        self._parameters = parameters
        self._armable_after_s = settings.armable_after_s
        self._endurance_s = settings.endurance_s
        self._battery_percent = settings.battery_percent
        self._drains_since_s: float | None = None

    def booting(self, now_s: float) -> bool:
        """Whether it does not speak yet."""
        return self.uptime_s(now_s) < min(_BOOT_S, self._armable_after_s)

    def checked(self, now_s: float) -> bool:
        """Whether its first checks have run."""
        return self.uptime_s(now_s) >= min(_FIRST_CHECKS_S, self._armable_after_s)

    def start_draining(self, now_s: float) -> None:
        """Its motors have started."""
        self._drains_since_s = now_s

    def stop_draining(self, now_s: float) -> None:
        """Its motors have stopped."""
        self._battery_percent, self._drains_since_s = self.battery_percent(now_s), None

    def battery_percent(self, now_s: float) -> float:
        """How full its battery is."""
        drained = 0.0
        if self._drains_since_s is not None:
            drained = (now_s - self._drains_since_s) * 100 / self._endurance_s
        left = max(0.0, self._battery_percent - drained)
        return min(left, _EMPTY_PERCENT) if self.suffers(FaultKind.BATTERY, now_s) else left

    def battery_v(self, now_s: float) -> float:
        """Its battery's voltage."""
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * self.battery_percent(now_s) / 100

    def battery_level(self, now_s: float) -> int:
        """MAV_BATTERY_CHARGE_STATE: 1 well, 2 low, 3 critical, 4 emergency."""
        left = self.battery_percent(now_s) / 100
        return 1 + sum(
            left <= self._parameters[name] for name in ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")
        )
