"""Events of a simulated vehicle without a command: incidents by others, and its empty battery."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass

from upwash.config.world import FaultConfig
from upwash.core.vehicle.control import Heartbeat
from upwash.sim.energy import EnergyMeter
from upwash.sim.link import Observe
from upwash.sim.over_time import OverTime
from upwash.sim.vehicle import STABILIZE, ModelVehicle
from upwash.sim.vehicle_link import ModelVehicleLink

_HEARTBEAT_S = 1.0
_LOOK_S = 0.5  # at a battery


class Incidents:
    """Carries out each incident at its time.

    `observe` gets "given_back_unheard" when a pilot gives the vehicle back before any report of the takeover has
    reached the program, and "jumped_unheard" when its position jumps within a silence of the link.
    """

    def __init__(
        self,
        incidents: Sequence[FaultConfig],
        vehicle: ModelVehicle,
        link: ModelVehicleLink,
        battery: ModelBattery,
        *,
        observe: Observe,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._vehicle = vehicle
        self._link = link
        self._battery = battery
        self._observe = observe
        for incident in incidents:
            self._loop.call_at(incident.from_s, self._happen, incident)

    def _happen(self, incident: FaultConfig) -> None:
        vehicle, lasts_s = self._vehicle, incident.to_s - incident.from_s
        if vehicle.is_booting:  # and knows of nothing
            return
        match incident.kind:
            case "pilot":
                vehicle.be_taken_by_pilot(back_after_s=lasts_s, before_back=self._check_unheard)
            case "fail-safe":
                vehicle.fail_safe()
            case "diverted":
                vehicle.be_diverted(incident.moved_m)
            case "home":
                vehicle.move_home(incident.moved_m)
            case "jump":
                self._jump_and_back(incident, lasts_s)
            case "restart":
                vehicle.restart(back_after_s=lasts_s)
            case "impostor":
                self._send_heartbeat(incident.to_s)
            case "battery":
                self._battery.add_second(lasts_s=incident.lasts_s, told_until_s=incident.to_s)
                self._drain_second()
        self._link.take_soon()

    def _jump_and_back(self, incident: FaultConfig, lasts_s: float) -> None:
        if self._vehicle.flies:
            east_m, north_m, _ = incident.moved_m
            self._jump(east_m, north_m)
            if math.isfinite(lasts_s):
                self._loop.call_later(lasts_s, self._jump, -east_m, -north_m)

    def _jump(self, east_m: float, north_m: float) -> None:
        before, after = self._vehicle.jump(east_m, north_m)
        if self._link.is_silent:
            self._observe("jumped_unheard")
        else:
            self._link.take_jump(before, after)

    def _send_heartbeat(self, until_s: float) -> None:
        self._link.take_heartbeat(Heartbeat(STABILIZE, armed=False), by_autopilot=False)
        if self._loop.time() + _HEARTBEAT_S < until_s:
            self._loop.call_later(_HEARTBEAT_S, self._send_heartbeat, until_s)

    def _drain_second(self) -> None:
        """Let the vehicle fall once its second battery is empty."""
        if self._battery.second_percent > 0:
            self._loop.call_later(_LOOK_S, self._drain_second)
        elif self._vehicle.flies:
            self._vehicle.fall()
            self._link.take_soon()

    def _check_unheard(self) -> None:
        if self._link.control.is_ours:
            self._observe("given_back_unheard")


@dataclass(frozen=True, slots=True)
class _SecondBattery:
    from_s: float  # of the flight
    lasts_s: float
    told_until_s: float  # of the world


class ModelBattery:
    """A battery with its meter's or a measured charge; else empty `endurance_s` after the take-off, or endless."""

    def __init__(
        self,
        vehicle: ModelVehicle,
        link: ModelVehicleLink,
        *,
        energy: EnergyMeter | None,
        endurance_s: float | None,
        measured: OverTime | None = None,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._vehicle = vehicle
        self._link = link
        self._energy = energy
        self._endurance_s = endurance_s
        self._measured = measured
        self._took_off_s: float | None = None
        self._second: _SecondBattery | None = None
        if energy is not None:
            self._watch(energy, energy.failsafe_percent)

    @property
    def failsafe_percent(self) -> float | None:
        """The level in percent at which the vehicle lands by itself; None without a meter."""
        return self._energy.failsafe_percent if self._energy else None

    @property
    def percent(self) -> float | None:
        """The charge in percent; None for an endless battery."""
        if self._measured is not None:
            return self._measured.at(self.flown_s)[0]
        if self._energy is not None:
            return self._energy.left_percent
        if self._endurance_s is None:
            return None
        return 100.0 * max(0.0, 1 - self.flown_s / self._endurance_s)

    @property
    def second_reported_percent(self) -> dict[int, float | None]:
        """The reported charge of the second battery by its number, None once it is silent; empty without one."""
        if self._second is None:
            return {}
        return {2: self.second_percent if self._loop.time() < self._second.told_until_s else None}

    @property
    def second_percent(self) -> float:
        """The charge of the second battery, in percent; 100 without one."""
        if self._second is None:
            return 100.0
        return 100.0 * max(0.0, 1 - (self.flown_s - self._second.from_s) / self._second.lasts_s)

    def add_second(self, *, lasts_s: float, told_until_s: float) -> None:
        """Add a full second battery, which lasts `lasts_s` in flight; `told_until_s` is when its reports end."""
        self._second = _SecondBattery(self.flown_s, lasts_s, told_until_s)

    @property
    def flown_s(self) -> float:
        """The time since the first take-off; 0 before."""
        return 0.0 if self._took_off_s is None else self._loop.time() - self._took_off_s

    def take_off(self) -> None:
        """Note that the vehicle takes off."""
        if self._took_off_s is None:
            self._took_off_s = self._loop.time()
            if self._energy is not None:
                self._energy.take_off()

    def _watch(self, energy: EnergyMeter, level_percent: float) -> None:
        """Land the vehicle once the battery is at the level, and let it fall once it is empty."""
        left_percent = energy.left_percent
        if left_percent is None:
            return
        if left_percent > level_percent:
            self._loop.call_later(energy.lasts_s(level_percent), self._watch, energy, level_percent)
            return
        if left_percent > 0:
            self._link.say(f"Battery Failsafe: {left_percent:.0f} % is left")
            self._vehicle.fail_safe()
            self._watch(energy, 0.0)
        else:
            self._link.say("Battery empty: the motors stop")
            self._vehicle.fall()
        self._link.take_soon()
