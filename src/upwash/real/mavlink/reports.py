"""The half of a MAVLink driver that only reports: those methods of ports.Autopilot that send no command."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import ClassVar

from msgspec import structs
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Circle, EarthPosition, LocalFrame, Position, Velocity
from upwash.core.planning.legs import PACES, Pace
from upwash.core.vehicle.control import Control
from upwash.core.vehicle.return_place import RallyPoints
from upwash.core.vehicle.telemetry import Telemetry
from upwash.core.vehicle.way_home import EnergyFacts, WayHome
from upwash.errors import AutopilotRefused, UsageError
from upwash.ports import DeadMan, VehicleLimits, VehicleNews
from upwash.real.mavlink.dead_man import NoDeadMan
from upwash.real.mavlink.rally import RallySite
from upwash.real.mavlink.settings import FlightSettings
from upwash.real.mavlink.shutter import ShutterReports
from upwash.real.mavlink.tracker import PositionTracker
from upwash.real.mavlink.vehicle import MavlinkVehicle

_LOW_M = 1.0  # above home
_FALL_SEEN_S, _FALLS_M_S = 0.3, 1.0  # a falling vehicle is faster, this long after its motors stopped
_POSITION, _HOME_POSITION, _SYSTEM_TIME = (
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
)


class ReportingAutopilot(ABC):
    """Reads the reports of a found vehicle."""

    usual_way_home: ClassVar[WayHome]  # until the vehicle's parameters are read

    def __init__(
        self,
        vehicle: MavlinkVehicle,
        *,
        frame: LocalFrame,
        ground_speed_m_s: float,
        settings: FlightSettings,
    ) -> None:
        check_speed(ground_speed_m_s)
        self.vehicle = vehicle
        self._telemetry = vehicle.telemetry
        self._frame = frame
        self._settings = settings
        self._ground_speed_m_s = ground_speed_m_s
        self._energy = EnergyFacts(way_home=self.usual_way_home)
        self._tracker = PositionTracker(vehicle, frame)
        self._listening = contextlib.ExitStack()
        self._listening.enter_context(vehicle.listening(self._tracker.hear))
        shutter = ShutterReports(vehicle.news.tell, vehicle.telemetry, frame)
        self._listening.enter_context(vehicle.listening(shutter.hear))

    @property
    def position(self) -> Position:
        """Where it is now, by its last report and velocity, from the mission's home; home until it knows its own."""
        return self._tracker.present_position

    @property
    def position_is_sure(self) -> bool:
        """Whether the reported position can be true, and the vehicle reports that it is sure of it."""
        return self._tracker.is_sure

    @property
    def earth_position(self) -> EarthPosition | None:
        """The same on the Earth; None until the vehicle knows it."""
        if self._telemetry.position is None:
            return None
        here, above_sea_m = self._tracker.present_position, self._telemetry.above_sea_m
        geo = self._frame.geo(here)
        if above_sea_m is not None:
            above_sea_m += here.altitude_m - self._tracker.position.altitude_m
        return EarthPosition(geo.latitude_deg, geo.longitude_deg, above_sea_m, self.vehicle.unix_s)

    @property
    def dead_man(self) -> DeadMan:
        """The dead man's switch; here a `NoDeadMan`, which refuses everything. Subclasses have real switches."""
        return NoDeadMan(self.vehicle.firmware.name)

    @property
    @abstractmethod
    def stopping_place(self) -> Position:
        """The position where the vehicle would come to rest if it braked now."""

    @property
    def telemetry(self) -> Telemetry:
        """The vehicle's last reports."""
        reported = self._telemetry
        return Telemetry(
            position=self.position,
            mode=self.vehicle.mode_name,
            armed=reported.armed,
            velocity=reported.velocity,
            attitude=reported.attitude,
            heading_deg=reported.heading_deg,
            gps=reported.gps,
            batteries=reported.batteries.charges_percent,
            gimbal=reported.gimbal,
        )

    @property
    def wind(self) -> Velocity | None:
        """The wind as the vehicle estimates it; None without a report."""
        return self._telemetry.wind

    @property
    def energy(self) -> EnergyFacts:
        """The battery's stages and the way home: the firmware's defaults until `limits` has read the parameters."""
        return structs.replace(self._energy, home=self._tracker.home)

    @property
    def pace(self) -> Pace | None:
        """How the average vehicle with this firmware flies; None if unknown."""
        return PACES.get(self.vehicle.firmware.name.lower())

    @property
    def control(self) -> Control:
        """The vehicle's owner, and why."""
        return self.vehicle.latch.control

    @property
    def armed(self) -> bool:
        """Whether the motors run, by the last heartbeat."""
        return self._telemetry.armed

    @property
    def stands(self) -> bool:
        """Whether the vehicle stands: by its landed state unless it falls, else if it is low with stopped motors."""
        stands = self._telemetry.stands
        if stands is None:
            low = self._telemetry.position is None or abs(self.position.altitude_m) <= _LOW_M
            return not self._telemetry.armed and low
        return stands and (self._telemetry.armed or not self._may_fall())

    def _seen_after_disarming(self) -> bool:
        return self.vehicle.heard_since(_POSITION, self._telemetry.disarmed_s + _FALL_SEEN_S)

    def _may_fall(self) -> bool:
        """Whether the motors stopped just now, or the vehicle has been falling since."""
        velocity = self._telemetry.velocity
        falls = velocity is not None and velocity.up_m_s < -_FALLS_M_S
        return not self._seen_after_disarming() or falls

    def listen(self, hear: Callable[[VehicleNews], None]) -> None:
        """Calls `hear` with all news, and first with the news since the connection was made."""
        self.vehicle.news.listen(hear)

    async def in_the_air(self) -> bool:
        """Whether the vehicle flies, by its landed state; waits for a report of it."""
        telemetry = self._telemetry

        def known() -> bool:
            landed = telemetry.on_ground or telemetry.in_the_air
            return telemetry.mode is not None and (
                not telemetry.armed or (landed and telemetry.position is not None)
            )

        async with self.vehicle.limited("start", self._settings.margin_s):
            await self.vehicle.until("start", known)
        return telemetry.armed and telemetry.in_the_air

    async def stood(self) -> None:
        """Waits, without a command, until the vehicle stands disarmed and its clock shows whether it restarted."""
        vehicle = self.vehicle
        await vehicle.until("follow", lambda: not self._telemetry.armed and self.stands)
        disarmed_s = self._telemetry.disarmed_s
        await vehicle.happens(
            "follow",
            lambda: vehicle.heard_since(_SYSTEM_TIME, disarmed_s),
            within_s=self._settings.words_s * 4,
        )

    async def border_crossed(self, circles: Sequence[Circle]) -> None:
        """Returns when the vehicle next enters or leaves any of the circles."""

        def inside() -> list[bool]:
            return [circle.contains(self.position) for circle in circles]

        before = inside()
        await self.vehicle.until("watch the borders", lambda: inside() != before)

    async def close(self) -> None:
        """Gives up the connection to the vehicle; the vehicle is left as it is."""
        self._listening.close()
        await self.vehicle.close()

    async def home_above_sea_m(self, tell_delay: Callable[[], None]) -> float:
        """The altitude of the vehicle's home above the sea (m); calls `tell_delay` before a long wait.

        Only questions are sent.

        Raises AutopilotRefused if the home is not known within the time for the vehicle's checks.
        """
        within_s = self._settings.ready_timeout_s
        deadline_s = self.vehicle.now_s + within_s
        await self._know_home()
        if self._telemetry.home is None:
            tell_delay()
        while self._telemetry.home is None and self.vehicle.now_s < deadline_s:
            await self._know_home()
        if self._telemetry.home is None:
            problem = (
                f"the vehicle did not tell its home within {within_s:g} s: wait for its GPS; nothing was sent"
            )
            raise AutopilotRefused("arm", problem, self.vehicle.said_lately)
        return round(self._telemetry.home.altitude_m, 2)

    async def _know_home(self) -> None:
        await self.vehicle.answered(
            "home",
            lambda: self.vehicle.ask_for(_HOME_POSITION),
            lambda: self._telemetry.home,
            times=self._settings.patience.attempts,
        )

    async def limits(self) -> VehicleLimits:
        """The vehicle's limits, from its home, its parameters, its fence list and its rally points."""
        await self._know_home()
        await self.learn()
        limits = await self._fenced(self._home_limits())
        return replace(limits, rally=await self.learn_rally(limits))

    def _home_limits(self) -> VehicleLimits:
        """The vehicle's home and the altitude of its return, without a fence."""
        home = self._telemetry.home
        return VehicleLimits(
            self._tracker.home,
            returns_at_m=self._energy.return_altitude_m,
            home_above_sea_m=round(home.altitude_m, 2) if home else None,
        )

    async def learn_rally(self, limits: VehicleLimits) -> RallyPoints:
        """Reads the vehicle's rally points, and has the way home count them; raises AutopilotError."""
        site = RallySite(self._frame, limits, self._energy.way_home or self.usual_way_home)
        rally = await self._rally(site)
        self._energy = structs.replace(self._energy, rally=rally)
        return rally

    @abstractmethod
    async def learn(self) -> None:
        """Read the parameters of the battery's stages, the way home and the greatest speeds."""

    @abstractmethod
    async def _rally(self, site: RallySite) -> RallyPoints:
        """The vehicle's rally points."""

    @abstractmethod
    async def _fenced(self, limits: VehicleLimits) -> VehicleLimits:
        """The limits, with those of the vehicle's fence added."""


def check_speed(ground_speed_m_s: float) -> None:
    """Raises UsageError for a speed that is not above 0."""
    if not ground_speed_m_s > 0:
        raise UsageError(f"the ground speed is {ground_speed_m_s} m/s; give a number above 0")
