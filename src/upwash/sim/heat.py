"""How a small computer gets hot, and slow: two thermal poles and a step-wise frequency.

The steps are those of a Raspberry Pi 4 (its documentation: from 80 °C down from 1500 MHz). Resistances and time
constants are chosen so that the thesis's mission shows the thesis's curve: calibration, not validation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

_STEPS = (1.0, 1000 / 1500, 750 / 1500, 600 / 1500)  # of the full frequency
_LIMIT_C = 80.0
_HYSTERESIS_C = 2.0
_PERIOD_S = 0.5  # between two looks of the governor at the thermometer


@dataclass(slots=True)
class _Pole:
    resistance_k_w: float
    time_constant_s: float
    rise_k: float = 0.0

    def run(self, power_w: float, duration_s: float) -> None:
        goal_k = self.resistance_k_w * power_w
        self.rise_k = goal_k + (self.rise_k - goal_k) * math.exp(-duration_s / self.time_constant_s)


@dataclass(slots=True)
class Heat:
    """A computer in air of `ambient_c` that burns `load_w` more under load."""

    ambient_c: float
    load_w: float
    _poles: tuple[_Pole, ...] = field(default_factory=lambda: (_Pole(1.6, 11.0), _Pole(16.0, 250.0)))
    _step: int = 0
    _until_s: float = 0.0

    @property
    def temperature_c(self) -> float:
        """The temperature now."""
        return self.ambient_c + sum(pole.rise_k for pole in self._poles)

    def rest(self, until_s: float) -> None:
        """Idles until that time."""
        for pole in self._poles:
            pole.run(0.0, max(0.0, until_s - self._until_s))
        self._until_s = max(self._until_s, until_s)

    def work(self, work_s: float, *, now_s: float) -> float:
        """Does `work_s` seconds' work of a cool computer from now on; returns how long that takes."""
        self.rest(now_s)
        left_s, took_s = work_s, 0.0
        while left_s > 0:
            self._govern()
            share = _STEPS[self._step]
            step_s = min(_PERIOD_S, left_s / share)
            for pole in self._poles:
                pole.run(self.load_w * share, step_s)
            left_s -= step_s * share
            took_s += step_s
        self._until_s = now_s + took_s
        return took_s

    def _govern(self) -> None:
        if self.temperature_c >= _LIMIT_C:
            self._step = min(self._step + 1, len(_STEPS) - 1)
        elif self.temperature_c < _LIMIT_C - _HYSTERESIS_C:
            self._step = max(self._step - 1, 0)
