"""Ends a mission by its battery: below a percentage, or when the way home would leave too little."""

from __future__ import annotations

import asyncio

from upwash.config.drone import DroneConfig
from upwash.config.flight_times import pace_in_numbers, told_pace
from upwash.core.geo import Position
from upwash.core.vehicle.energy import FlightEnergy, FlightReport, Margin, Reserve, in_battery
from upwash.drone.coming_down import Homecoming
from upwash.drone.legs import Legs
from upwash.eventlog import schema
from upwash.support.background import now_s

_LOOK_S = 1.0
_SILENT_LOOKS = 10  # the battery is among the last things that a vehicle reports after a start
_TELL_AGAIN_S = 60.0
_TELL_AGAIN_PERCENT = 3.0  # of the margin
_HOME = Position(0.0, 0.0)


class ReserveWatch:
    """Checks the battery every second, on the ground and in the air, and on the way down."""

    def __init__(self, config: DroneConfig, legs: Legs, homecoming: Homecoming) -> None:
        mission = config.mission
        self._least_percent = mission.reserve_percent
        self._energy: FlightEnergy | None = None
        if mission.reserve_s is not None:
            self._energy = FlightEnergy(
                Reserve(mission.reserve_s, mission.reserve_percent),
                endurance_s=config.vehicle.endurance_s,
                lands=config.autopilot.on_failure == "land",
            )
        self.pace = told_pace(config.vehicle) or pace_in_numbers(config.vehicle)
        self._legs, self._autopilot, self._journal = legs, legs.autopilot, legs.journal
        self._homecoming = homecoming
        self._home = _HOME  # where it was last seen before it took off
        self._has_flown = False
        self._told: tuple[float, Margin] | None = None  # when, and what
        self._unwatched: set[int] = set()  # batteries, as told
        self._now: Margin | None = None

    def home_s(self, place: Position) -> float:
        """The seconds from a place to the ground at home, on average."""
        return self.pace.home_share * self._autopilot.energy.time_home_s(place)

    def spare_s(self) -> float | None:
        """The seconds of flight that the reserve leaves; None if nothing tells."""
        if self._now is None or not self._now.rate_percent_s:
            return None
        return max(0.0, self._now.percent) / self._now.rate_percent_s

    async def reached(self) -> str:
        """Waits until the mission must end, and returns why; never returns without a reserve."""
        if self._least_percent is None and self._energy is None:
            await asyncio.get_running_loop().create_future()
        silent = 0
        while not (why := self._look()):
            silent += self._autopilot.telemetry.battery_percent is None
            if silent == _SILENT_LOOKS:
                self._journal.record(schema.BatteryWatchFailed(why="the vehicle does not report its battery"))
            self._name_unwatched()
            await asyncio.sleep(_LOOK_S)
        return why

    def _name_unwatched(self) -> None:
        told = self._autopilot.telemetry
        unknown = {number for number, percent in told.batteries.items() if percent is None}
        for number in sorted(unknown - self._unwatched) if told.charges_percent else ():
            why = f"the vehicle does not report the charge of its battery {number}"
            self._journal.record(schema.BatteryWatchFailed(why=why))
        self._unwatched = unknown if told.charges_percent else self._unwatched

    def _look(self) -> str:
        told = self._autopilot.telemetry
        percent, energy = told.battery_percent, self._energy
        if energy is not None:
            now = self._in_flight(energy) if self._legs.in_the_air else self._before_flight(energy)
            if now is not None and now.turn_back:
                return str(now)
        if percent is not None and self._least_percent is not None and percent < self._least_percent:
            battery = in_battery(told.lowest_battery) or " in the battery"
            return f"{percent:.0f} % is left{battery}, less than the reserve of {self._least_percent:g} %"
        return ""

    def _before_flight(self, energy: FlightEnergy) -> Margin | None:
        """The margin on the ground; None after the flight, when the mission ends by itself."""
        if self._has_flown:
            return None
        self._home = self._autopilot.position
        return energy.standing_margin(self._autopilot.telemetry.charges_percent, self._autopilot.energy)

    def _in_flight(self, energy: FlightEnergy) -> Margin | None:
        self._has_flown = True
        vehicle = self._autopilot
        told = vehicle.telemetry
        report = FlightReport(
            time_s=now_s(),
            position=vehicle.position,
            charges_percent=told.charges_percent,
            velocity=told.velocity,
            leg_speed_m_s=self._legs.leg_speed_m_s,
            wind=vehicle.wind,
        )
        energy.take(report)
        now = energy.margin(report, self._home, vehicle.energy, down_s=self._homecoming.left_s)
        if now is not None:
            self._now = now
            self._tell(now, report.time_s)
        return now

    def _tell(self, now: Margin, time_s: float) -> None:
        """Log the margin when it is first known, when it has changed, each minute, and when it is used up."""
        if now.rate_percent_s is None:
            return
        if self._told is not None:
            told_s, told = self._told
            changed = abs(now.percent - told.percent) > _TELL_AGAIN_PERCENT and not now.turn_back
            is_news = changed or now.turn_back > told.turn_back
            if not is_news and time_s - told_s < _TELL_AGAIN_S:
                return
        self._told = time_s, now
        self._journal.record(
            schema.Energy(
                left_percent=round(now.left_percent, 1),
                rate_percent_s=round(now.rate_percent_s, 4),
                home_s=round(now.home_s, 1),
                needed_percent=round(now.needed_percent, 1),
                floor_percent=round(now.floor_percent, 1),
                margin_percent=round(now.percent, 1),
                guessed=list(now.guessed),
                battery=now.battery,
            )
        )
