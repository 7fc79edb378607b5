"""What a simulated drone draws from its battery: its rotors, its computer and its radios, each a small model.

docs/scenarios.md has the models and their sources. The defaults of the rotors are the example of Zeng, Xu and Zhang:
a drone of 20 N on a disc of 0.503 m². It takes 79.86 W + 88.63 W in hover, with U = 120 m/s and v = 4.03 m/s; its
drag is 0.00924 W s³/m³. The extras of flying forward and up at once are added.

Assumed: a descent costs what level flight does, as momentum theory does not hold in a slow descent; speeding up and
braking cost nothing; the battery gives all that it holds at every load. The energy of a call is counted as it begins.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable

from upwash.config.world import EnergyConfig
from upwash.core.geo import Velocity
from upwash.eventlog.schema import EnergyUsed
from upwash.sim.over_time import OverTime
from upwash.vehicle.body.kinematics import Motion, Phase

_J_IN_WH = 3600.0
_NODES = (
    ((1 - math.sqrt(0.6)) / 2, 5 / 18),
    (0.5, 8 / 18),
    ((1 + math.sqrt(0.6)) / 2, 5 / 18),
)  # Gauss-Legendre
_DIGITS = 6
_MOST = 4.0  # times the power of hovering: no flight takes more
_LEAST_S = 0.5  # between two looks at the battery
_WIND_STEP_S = 1.0


class Rotors:
    """The power of the rotors, by the drone's motion."""

    def __init__(self, config: EnergyConfig) -> None:
        self.hover_w = config.hover_w
        self._blades_w = config.hover_w * config.blade_share
        self._induced_w = config.hover_w - self._blades_w
        self._tip_m_s = config.tip_speed_m_s
        self._induced_m_s = config.induced_speed_m_s
        self._drag_w_s3_m3 = config.drag_at_10_m_s_w / 10.0**3

    def power_w(self, velocity: Velocity) -> float:
        """The power in watts at that velocity through still air."""
        squared = velocity.east_m_s**2 + velocity.north_m_s**2
        blades_w = self._blades_w * (1 + 3 * squared / self._tip_m_s**2)
        ratio = squared / (2 * self._induced_m_s**2)
        induced = 1 / math.sqrt(math.sqrt(1 + ratio**2) + ratio)  # the paper's: no difference of like numbers
        drag_w = self._drag_w_s3_m3 * squared * math.sqrt(squared)
        rise = max(velocity.up_m_s, 0.0) / (2 * self._induced_m_s)
        climb = rise + math.sqrt(rise**2 + 1) - 1
        return blades_w + self._induced_w * (induced + climb) + drag_w

    def energy_j(self, phase: Phase, elapsed_s: float) -> float:
        """The energy in joules from the start of the phase until `elapsed_s`.

        For a ramp from rest to 20 m/s the error is below 0.2 %, for slower ramps less.
        """
        if not (phase.acceleration_m_s2 or phase.jerk_m_s3):
            return elapsed_s * self.power_w(phase.velocity(0.0))
        return elapsed_s * sum(
            weight * self.power_w(phase.velocity(node * elapsed_s)) for node, weight in _NODES
        )


class EnergyMeter:
    """Adds up the energy that a drone draws, by part; radios and computer draw from its creation until it is read.

    `load_w` is the power that a call adds to the computer's, `wind` the measured wind since the take-off.
    """

    def __init__(
        self, config: EnergyConfig, *, load_w: float, radios: int, wind: OverTime | None = None
    ) -> None:
        self.load_w = load_w
        self._config = config
        self._radios = radios
        self._most_w = (
            _MOST * config.hover_w
            + config.computer_idle_w
            + load_w
            + radios * (config.radio_idle_w + config.radio_transfer_w)
        )
        self._rotors = Rotors(config)
        self._loop = asyncio.get_running_loop()
        self._began_s = self._loop.time()
        self._flight_j = self._hover_j = 0.0  # until _since_s
        self._since_s = self._began_s
        self._phases: deque[Phase] = deque()  # from then on,
        self._rests_up = False  # ... and then it hovers, or stands
        self._load_j = self._transfer_s = 0.0
        self._wind = wind
        self._took_off_s: float | None = None

    def take_off(self) -> None:
        """Note that the drone takes off: times of the wind count from now."""
        self._took_off_s = self._loop.time()

    def move(self, motion: Motion[Phase]) -> None:
        """Note a new motion of the drone, at whose end it rests."""
        self._flight_j, self._hover_j = self._rotors_j()
        self._since_s = motion.begun_s
        self._phases = deque(motion.phases)
        self._rests_up = motion.end.altitude_m > 0

    def compute(self, load_j: float) -> None:
        """Add the energy of a call to the computer's idle load."""
        self._load_j += load_j

    def transfer(self, transfer_s: float) -> None:
        """Add a transfer of a radio for that time."""
        self._transfer_s += transfer_s

    def used(self) -> EnergyUsed:
        """The energy drawn until now, by part."""
        flight_j, hover_j, computing_j, radio_j = self._drawn_j()
        return EnergyUsed(
            flight_wh=_wh(flight_j),
            hover_wh=_wh(hover_j),
            computing_wh=_wh(computing_j),
            radio_wh=_wh(radio_j),
            battery_wh=self._config.battery_wh,
        )

    @property
    def failsafe_percent(self) -> float:
        """The level of the fail-safe landing."""
        return self._config.failsafe_percent

    @property
    def left_percent(self) -> float | None:
        """The charge in percent of a full battery; None without a limit."""
        if self._config.battery_wh is None:
            return None
        return 100.0 * max(0.0, 1 - sum(self._drawn_j()) / (self._config.battery_wh * _J_IN_WH))

    def lasts_s(self, level_percent: float) -> float:
        """Seconds for which the battery surely stays above the level; more than 0, to check again after that."""
        if self._config.battery_wh is None or self.left_percent is None:
            return math.inf
        above_j = (self.left_percent - level_percent) / 100 * self._config.battery_wh * _J_IN_WH
        return max(_LEAST_S, above_j / self._most_w)

    def _drawn_j(self) -> tuple[float, float, float, float]:
        """The energy in joules until now: flight, hover, computing, radio."""
        config, on_s = self._config, self._loop.time() - self._began_s
        computing_j = on_s * config.computer_idle_w + self._load_j
        radio_j = on_s * self._radios * config.radio_idle_w + self._transfer_s * config.radio_transfer_w
        return *self._rotors_j(), computing_j, radio_j

    def _rotors_j(self) -> tuple[float, float]:
        """The energy in joules until now, in flight and in hover; finished phases are added up once."""
        now_s = self._loop.time()
        while self._phases and (ended_s := self._since_s + self._phases[0].duration_s) <= now_s:
            phase = self._phases.popleft()
            flight_j, hover_j = self._phase_j(phase, phase.duration_s)
            self._flight_j += flight_j
            self._hover_j += hover_j
            self._since_s = ended_s
        if self._phases:
            flight_j, hover_j = self._phase_j(self._phases[0], now_s - self._since_s)
        else:
            flight_j, hover_j = 0.0, self._hover_j_in(now_s - self._since_s) * self._rests_up
        return self._flight_j + flight_j, self._hover_j + hover_j

    def _phase_j(self, phase: Phase, elapsed_s: float) -> tuple[float, float]:
        """The energy in joules since the start of the phase, in flight and in hover; 0 on the ground."""
        if phase.speed_m_s or phase.acceleration_m_s2 or phase.jerk_m_s3:
            if self._wind is not None:
                return self._in_wind_j(phase.velocity, elapsed_s), 0.0
            return self._rotors.energy_j(phase, elapsed_s), 0.0
        return 0.0, self._hover_j_in(elapsed_s) * (phase.start.altitude_m > 0)

    def _hover_j_in(self, lasts_s: float) -> float:
        if self._wind is not None:
            return self._in_wind_j(lambda _: Velocity(), lasts_s)
        return self._rotors.hover_w * lasts_s

    def _in_wind_j(self, velocity: Callable[[float], Velocity], lasts_s: float) -> float:
        """The energy in joules since `_since_s` at a velocity over the ground, through air that moves."""
        assert self._wind is not None  # noqa: S101 - asked only then
        took_off_s = self._since_s if self._took_off_s is None else self._took_off_s
        steps = math.ceil(lasts_s / _WIND_STEP_S)
        drawn_j = 0.0
        for step in range(steps):
            at_s = (step + 0.5) * lasts_s / steps
            over_ground = velocity(at_s)
            east_m_s, north_m_s = self._wind.at(self._since_s + at_s - took_off_s)
            through_air = Velocity(
                over_ground.east_m_s - east_m_s, over_ground.north_m_s - north_m_s, over_ground.up_m_s
            )
            drawn_j += self._rotors.power_w(through_air) * lasts_s / steps
        return drawn_j


def _wh(energy_j: float) -> float:
    return round(energy_j / _J_IN_WH, _DIGITS)
