"""The battery of a vehicle on paper: how full it is, and what the vehicle does by itself as it empties."""

from __future__ import annotations

import asyncio

from upwash.sim.energy import EnergyMeter
from upwash.sim.hearing import Hearing
from upwash.sim.vehicle import ModelVehicle


class Battery:
    """As full as the meter says; without a meter, empty `endurance_s` after the first take-off, or endless."""

    def __init__(
        self,
        vehicle: ModelVehicle,
        hearing: Hearing,
        *,
        energy: EnergyMeter | None,
        endurance_s: float | None,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._vehicle = vehicle
        self._hearing = hearing
        self._energy = energy
        self._endurance_s = endurance_s
        self._took_off_s: float | None = None
        if energy is not None:
            self._watch(energy, energy.failsafe_percent)

    @property
    def failsafe_percent(self) -> float | None:
        """At this level the vehicle lands by itself; None for one without a meter."""
        return self._energy.failsafe_percent if self._energy else None

    @property
    def percent(self) -> float | None:
        """What is left; None for an endless one."""
        if self._energy is not None:
            return self._energy.left_percent
        if self._endurance_s is None:
            return None
        flown_s = 0.0 if self._took_off_s is None else self._loop.time() - self._took_off_s
        return 100.0 * max(0.0, 1 - flown_s / self._endurance_s)

    def take_off(self) -> None:
        """The vehicle takes off now."""
        if self._took_off_s is None:
            self._took_off_s = self._loop.time()

    def _watch(self, energy: EnergyMeter, level_percent: float) -> None:
        """Has the vehicle land by itself once the battery is down to the level, and fall once it is empty."""
        left_percent = energy.left_percent
        if left_percent is None:
            return
        if left_percent > level_percent:
            self._loop.call_later(energy.lasts_s(level_percent), self._watch, energy, level_percent)
            return
        if left_percent > 0:
            self._hearing.say(f"Battery Failsafe: {left_percent:.0f} % is left")
            self._vehicle.fail_safe()
            self._watch(energy, 0.0)
        else:
            self._hearing.say("Battery empty: the motors stop")
            self._vehicle.fall()
        self._hearing.take_soon()
