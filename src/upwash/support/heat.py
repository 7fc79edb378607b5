"""How a small computer gets hot, and slow: two thermal poles and a step-wise frequency.

The frequencies and the 80 °C are those of a Raspberry Pi 4 (its documentation). The rest is fitted to the thesis's
mission without offloading: heavy calls of 10 s with 10 s between them. The thesis prints a mean. By its mission
times a heavy call takes (47.5 - 26.5) min / 121 longer than a light call of 3 s: 13.4 s on average (13.6 s in its
simulation). The calls level off "only after a large number of invocations". The ambient temperature, 45 °C, is
fitted to that mean. The poles, the hysteresis and the exponent of power let the slow-down begin with the eighth
call and end by the twenty-fourth. This is calibration, not validation. Calls level off at 13.8 s; with 5 s between
them at 15.9 s, with 15 s at 12.0 s, with 20 s at 10.8 s. The model does not hold for another computer, case or
wind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from msgspec import Struct

from upwash.kinds import NotNegative

_STEPS = (1.0, 1000 / 1500, 750 / 1500, 600 / 1500)  # of the full frequency
_LIMIT_C = 80.0
_HYSTERESIS_C = 0.5
_PERIOD_S = 0.5  # between two looks of the governor at the thermometer
_NEGLIGIBLE_S = 1e-9  # what rounding leaves of a call's work
_POWER_EXPONENT = 1.4  # power over frequency: the voltage falls with the frequency, so more than linear


@dataclass(slots=True)
class _Pole:
    resistance_k_w: float
    time_constant_s: float
    rise_k: float = 0.0

    def run(self, power_w: float, duration_s: float) -> None:
        goal_k = self.resistance_k_w * power_w
        self.rise_k = goal_k + (self.rise_k - goal_k) * math.exp(-duration_s / self.time_constant_s)

    def add(self, power_w: float, duration_s: float, *, ago_s: float) -> None:
        """Add the heat of that power, which lasted for the duration and ended `ago_s` ago."""
        left = math.exp(-ago_s / self.time_constant_s) - math.exp(
            -(ago_s + duration_s) / self.time_constant_s
        )
        self.rise_k += self.resistance_k_w * power_w * left


class Surroundings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The drone's computer gets hot, and slow."""

    ambient_c: float = 44.0
    """The temperature of the air around the computer, in °C."""
    load_w: NotNegative = 4.0
    """The power that a call adds to the computer's, in watts."""


@dataclass(slots=True)
class Heat:
    """A computer in these surroundings."""

    surroundings: Surroundings
    _poles: tuple[_Pole, ...] = field(default_factory=lambda: (_Pole(5.8, 8.0), _Pole(15.0, 186.0)))
    _step: int = 0
    _looked_c: float = 0.0  # the temperature at the governor's last look
    _until_s: float = 0.0
    burnt_j: float = 0.0  # by all work until now

    @property
    def temperature_c(self) -> float:
        """The temperature now."""
        return self.surroundings.ambient_c + sum(pole.rise_k for pole in self._poles)

    def rest(self, until_s: float) -> None:
        """Idles until that time."""
        for pole in self._poles:
            pole.run(0.0, max(0.0, until_s - self._until_s))
        self._until_s = max(self._until_s, until_s)

    def work(self, work_s: float, *, now_s: float) -> float:
        """Does `work_s` seconds' work of a cool computer from now on; returns how long that takes.

        Simultaneous work adds its heat; the duration of that other work stays as it was returned.
        """
        self.rest(now_s)
        left_s, took_s, beside_s = work_s, 0.0, self._until_s - now_s
        while left_s > _NEGLIGIBLE_S:
            self._govern()
            share = _STEPS[self._step]
            step_s = min(_PERIOD_S, left_s / share)
            power_w = self.surroundings.load_w * share**_POWER_EXPONENT
            if took_s < beside_s:
                step_s = min(step_s, beside_s - took_s)
                for pole in self._poles:
                    pole.add(power_w, step_s, ago_s=beside_s - took_s - step_s)
            else:
                for pole in self._poles:
                    pole.run(power_w, step_s)
            self.burnt_j += power_w * step_s
            left_s -= step_s * share
            took_s += step_s
        self._until_s = max(self._until_s, now_s + took_s)
        return took_s

    def _govern(self) -> None:
        temperature_c = self.temperature_c
        rising = temperature_c > self._looked_c
        if temperature_c >= _LIMIT_C and rising:  # a step may already be cooling it: see first
            self._step = min(self._step + 1, len(_STEPS) - 1)
        elif temperature_c < _LIMIT_C - _HYSTERESIS_C:
            self._step = max(self._step - 1, 0)
        self._looked_c = temperature_c
