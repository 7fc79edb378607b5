"""ports.Autopilot for a vehicle over MAVLink: what all firmwares have in common.

A pilot or a fail-safe may take the vehicle at any time. The latch then closes, the verb in progress raises
AutopilotOverruled, and no verb sends anything any more. What differs from firmware to firmware is a subclass's.
"""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import (
    Circle,
    EarthPosition,
    LocalFrame,
    Position,
    Velocity,
    distance_m,
    ground_distance_m,
)
from upwash.core.planning.legs import PACES, Pace
from upwash.core.vehicle.control import Control
from upwash.core.vehicle.telemetry import Telemetry
from upwash.core.vehicle.way_home import EnergyFacts
from upwash.errors import AutopilotRefused, UsageError
from upwash.mavlink.version import Version
from upwash.ports import ArmingDelayed, DeadMan, VehicleLimits, VehicleNews
from upwash.real.mavlink.dead_man import NoDeadMan
from upwash.real.mavlink.identity import Heard
from upwash.real.mavlink.needs import require_version
from upwash.real.mavlink.settings import FlightSettings
from upwash.real.mavlink.vehicle import MavlinkVehicle
from upwash.real.mavlink.whereabouts import Whereabouts

_HOME = Position(0.0, 0.0)
_LOW_M = 1.0  # above home
_FALL_SEEN_S, _FALLS_M_S = 0.3, 1.0  # after its motors stopped, one that falls is faster
_TURN_S = 20.0  # half a turn, of a vehicle that turns slowly
_POINTS_WITHIN_DEG = 5.0
_POSITION, _HOME_POSITION, _EXTENDED_SYS_STATE, _SYSTEM_TIME = (
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
)


class MavlinkAutopilot(ABC):
    """A vehicle that has been heard; which commands its verbs are is the subclass's."""

    return_mode: ClassVar[str]
    land_mode: ClassVar[str]

    def __init__(
        self,
        vehicle: MavlinkVehicle,
        *,
        frame: LocalFrame,
        ground_speed_m_s: float,
        settings: FlightSettings,
    ) -> None:
        check_speed(ground_speed_m_s)
        self._vehicle = vehicle
        self._telemetry = vehicle.telemetry
        self._frame = frame
        self._settings = settings
        self._ground_speed_m_s = ground_speed_m_s
        self._where = Whereabouts(vehicle, frame)
        self._listening = contextlib.ExitStack()
        self._listening.enter_context(vehicle.listening(self._where.hear))
        self._delayed_by: tuple[str, ...] | None = None  # why it could not be armed, as it was last told

    # --- what it reports ------------------------------------------------------------------------------------

    @property
    def firmware(self) -> str:
        """What it runs."""
        return self._vehicle.firmware.name

    @property
    def identity(self) -> Heard:
        """Its ids and its type."""
        return self._vehicle.found_vehicle

    @property
    def version(self) -> Version | None:
        """Of its firmware; None if the vehicle does not tell it."""
        return self._vehicle.version

    @property
    def battery_percent(self) -> float | None:
        """How full the battery is, as the vehicle reports it; None while it does not."""
        return self._telemetry.battery_percent

    @property
    def dead_man(self) -> DeadMan:
        """None, unless a subclass has one."""
        return NoDeadMan(self.firmware)

    @property
    def velocity(self) -> Velocity | None:
        """Over the ground, as it reports it."""
        return self._telemetry.velocity

    @property
    @abstractmethod
    def stopping_place(self) -> Position:
        """Where it would come to rest if it braked now."""

    @property
    def heading_deg(self) -> float | None:
        """Where its nose points, as it reports it."""
        return self._telemetry.heading_deg

    @property
    def telemetry(self) -> Telemetry:
        """As it reports it."""
        told = self._telemetry
        return Telemetry(
            position=self.position,
            mode=self._vehicle.mode_name,
            armed=told.armed,
            velocity=told.velocity,
            attitude=told.attitude,
            heading_deg=told.heading_deg,
            gps=told.gps,
            battery_percent=told.battery_percent,
        )

    @property
    def wind(self) -> Velocity | None:
        """As it estimates it."""
        return self._telemetry.wind

    @property
    def energy(self) -> EnergyFacts:
        """Its home; a subclass adds its battery's stages and how it returns."""
        return EnergyFacts(home=self._where.home)

    @property
    def pace(self) -> Pace | None:
        """That of its firmware."""
        return PACES.get(self.firmware.lower())

    @property
    def unix_s(self) -> float | None:
        """The time now by the vehicle's GPS, in seconds since 1970; None while it does not know it."""
        return self._vehicle.unix_s

    @property
    def control(self) -> Control:
        """Who has it."""
        return self._vehicle.latch.control

    @property
    def armed(self) -> bool:
        """Whether its motors run."""
        return self._telemetry.armed

    @property
    def stands(self) -> bool:
        """By its landed state, unless it falls; where it tells none, by its altitude with its motors stopped."""
        told = self._telemetry.stands
        if told is None:
            low = self._telemetry.position is None or abs(self.position.altitude_m) <= _LOW_M
            return not self._telemetry.armed and low
        return told and (self._telemetry.armed or not self._may_fall())

    def _may_fall(self) -> bool:
        """Whether its motors stopped just now, or it has been falling since."""
        told = self._telemetry
        seen = self._vehicle.heard_since(_POSITION, told.disarmed_s + _FALL_SEEN_S)
        return not seen or (told.velocity is not None and told.velocity.up_m_s < -_FALLS_M_S)

    @property
    def linked(self) -> bool:
        """Whether the vehicle has been heard lately."""
        return self._vehicle.linked

    @property
    def position(self) -> Position:
        """The last known position, relative to the mission's home; home until the vehicle knows its own."""
        return self._where.position

    @property
    def earth_position(self) -> EarthPosition | None:
        """As it reports it; None until it knows its own."""
        geo, told = self._telemetry.position, self._telemetry
        if geo is None:
            return None
        return EarthPosition(geo.latitude_deg, geo.longitude_deg, told.above_sea_m, self.unix_s)

    async def link_lost(self) -> None:
        """Returns when the vehicle has not been heard for `patience.quiet_after_s`, which is below 3 s."""
        await self._vehicle.link_lost()

    async def link_restored(self) -> None:
        """Returns when the vehicle is heard again."""
        await self._vehicle.link_restored()

    def listen(self, hear: Callable[[VehicleNews], None]) -> None:
        """All news, and first those since it was connected."""
        self._vehicle.listen(hear)

    async def in_the_air(self) -> bool:
        """By its landed state; waits until it tells."""
        async with self._vehicle.limited("start", self._settings.margin_s):
            await self._vehicle.until("start", self._tells_whether_it_flies)
        return self._telemetry.armed and self._telemetry.in_the_air

    def _tells_whether_it_flies(self) -> bool:
        telemetry = self._telemetry
        told = telemetry.on_ground or telemetry.in_the_air
        heard = telemetry.mode is not None
        return heard and (not telemetry.armed or (told and telemetry.position is not None))

    async def stood(self) -> None:
        """When it stands disarmed, and has said by its clock whether it restarted; sends nothing."""
        vehicle = self._vehicle
        await vehicle.until("follow", lambda: not self._telemetry.armed and self.stands)
        disarmed_s = self._telemetry.disarmed_s
        await vehicle.happens(
            "follow",
            lambda: vehicle.heard_since(_SYSTEM_TIME, disarmed_s),
            within_s=self._settings.words_s * 4,
        )

    async def border_crossed(self, circles: Sequence[Circle]) -> None:
        """Returns when the vehicle next enters or leaves any of the circles."""
        before = self._inside(circles)
        await self._vehicle.until("watch the borders", lambda: self._inside(circles) != before)

    async def close(self) -> None:
        """Gives up the connection to the vehicle; the vehicle is left as it is."""
        self._listening.close()
        await self._vehicle.close()

    # --- verbs ----------------------------------------------------------------------------------------------

    async def claim(self, *, resumes: bool) -> None:
        """By its last heartbeat."""
        async with self._vehicle.limited("start", self._settings.margin_s):
            await self._vehicle.until("start", lambda: self._telemetry.mode is not None)
        self._vehicle.claim("start", resumes=resumes)
        if self._telemetry.armed:  # it flies already: `limits` is for a vehicle that stands
            self._where.fix_ground()
            await self.learn()

    async def inspect(self) -> None:
        """Looks at the vehicle by questions alone; AutopilotRefused where it cannot be flown."""
        require_version(self._vehicle)

    async def ready(self) -> None:
        """Inspects it, and waits for its own checks without a command; tells its reasons as they change."""
        await self.inspect()
        settings, vehicle = self._settings, self._vehicle
        deadline_s = vehicle.now_s + settings.ready_timeout_s
        while not self._may_be_armed():
            self._refuse_two_vehicles()
            begun_s = vehicle.now_s
            self._ask_why_not_armable()
            within_s = min(settings.ask_again_s, max(deadline_s - begun_s, settings.patience.answer_s))
            for until_s in (0.0, min(settings.words_s, within_s), within_s):
                await vehicle.happens("arm", self._may_be_armed, within_s=begun_s + until_s - vehicle.now_s)
                vehicle.require_control("arm")
                vehicle.require_alone("arm")
                if not self._may_be_armed():
                    self._tell_delay(self._reasons_since(begun_s) or self._own_reasons())
            if vehicle.now_s >= deadline_s and vehicle.linked and not self._may_be_armed():
                raise self._not_ready(self._delayed_by or ())

    def _refuse_two_vehicles(self) -> None:
        if self._where.leaps_to_and_fro:
            system, _ = self._vehicle.ids
            raise AutopilotRefused(
                "arm",
                f"{self._where.restless}, again and again: either two vehicles send as system {system} on this link, "
                "or its GPS is lost; give each vehicle a number of its own (SYSID_THISMAV or MAV_SYS_ID), or wait "
                "for a good fix; nothing was sent",
                self._vehicle.said_lately,
            )

    def _tell_delay(self, reasons: tuple[str, ...]) -> None:
        """Tells why it cannot be armed, where that is new; it may be silent for a while about what it said before."""
        reasons = reasons or self._delayed_by or ()
        if reasons != self._delayed_by:
            self._delayed_by = reasons
            self._vehicle.tell(ArmingDelayed(reasons))

    def _not_ready(self, reasons: tuple[str, ...]) -> AutopilotRefused:
        own = self._own_reasons()
        said = "; ".join(reason for reason in reasons if reason not in own)
        because = f": {'; '.join(own)}" if own else ""
        within_s = self._settings.ready_timeout_s
        return AutopilotRefused("arm", f"the vehicle was not ready within {within_s:g} s{because}", said)

    async def home_above_sea_m(self, tell_delay: Callable[[], None]) -> float:
        """How high its home lies, in metres above the sea; only asks for it, as long as for its checks at most.

        Where its home is not known at once, `tell_delay` is called. AutopilotRefused where it never is.
        """
        within_s = self._settings.ready_timeout_s
        deadline_s = self._vehicle.now_s + within_s
        await self._know_home()
        if self._telemetry.home is None:
            tell_delay()
        while self._telemetry.home is None and self._vehicle.now_s < deadline_s:
            await self._know_home()
        if self._telemetry.home is None:
            problem = (
                f"the vehicle did not tell its home within {within_s:g} s: wait for its GPS; nothing was sent"
            )
            raise AutopilotRefused("arm", problem, self._vehicle.said_lately)
        return round(self._telemetry.home.altitude_m, 2)

    async def limits(self) -> VehicleLimits:
        """Its home; a subclass adds its fence."""
        await self._know_home()
        home = self._telemetry.home
        return VehicleLimits(self._where.home, home_above_sea_m=round(home.altitude_m, 2) if home else None)

    @abstractmethod
    async def learn(self) -> None:
        """Reads what its parameters say of its battery's stages, of its way home and of what it can do."""

    @abstractmethod
    async def arm(self) -> None:
        """Starts the motors; AutopilotRefused has its reason if not."""

    @abstractmethod
    async def takeoff(self, altitude_m: float) -> None:
        """Climbs to the altitude above home; returns when it is reached."""

    @abstractmethod
    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Sets the speed of the legs that follow."""

    @abstractmethod
    async def goto(self, position: Position) -> None:
        """Flies to the position; returns on arrival, at rest and with a position that it is sure of."""

    async def turn_to(self, heading_deg: float) -> None:
        """Returns once it reports that heading, nearly."""
        step = f"turn to {heading_deg:g} degrees"
        async with self._vehicle.limited(step, self._settings.margin_s + _TURN_S):
            await self._begin_turn(step, heading_deg)
            await self._while_ours(step, lambda: self._points_to(heading_deg))

    async def command(self, number: int, name: str, parameters: Sequence[float]) -> None:
        """As COMMAND_LONG."""
        async with self._vehicle.limited(name, self._settings.margin_s):
            await self._vehicle.command(name, number, *parameters)

    def say(self, severity: int, text: str) -> None:
        """As STATUSTEXT, in chunks where it is long."""
        self._vehicle.say(severity, text)

    @abstractmethod
    async def hold(self) -> None:
        """Stops and hovers as soon as it can."""

    async def return_home_and_land(self) -> None:
        """Flies back to where it took off and lands; returns on touchdown."""
        altitude_m = max(self.position.altitude_m, self._settings.return_altitude_m)
        home_s = self._leg_s(self._where.home or _HOME) + 2 * self._vertical_s(altitude_m)
        await self._land_in("return home and land", self.return_mode, timeout_s=home_s)

    async def land(self) -> None:
        """Lands where it is; returns on touchdown."""
        await self._land_in("land", self.land_mode, timeout_s=self._vertical_s(self.position.altitude_m))

    async def disarm(self) -> None:
        """Stops the motors; refused by the vehicle in flight."""
        async with self._vehicle.limited("disarm", self._settings.margin_s):
            await self._vehicle.arm("disarm", armed=False)

    # --- what verbs are made of -----------------------------------------------------------------------------

    @abstractmethod
    async def _begin_turn(self, step: str, heading_deg: float) -> None:
        """Has it turn its nose there; AutopilotRefused where it does not fly."""

    def _points_to(self, heading_deg: float) -> bool:
        now_deg = self._telemetry.heading_deg
        return now_deg is not None and abs(math.remainder(heading_deg - now_deg, 360)) <= _POINTS_WITHIN_DEG

    def _require_flying(self, step: str) -> None:
        self._vehicle.require_control(step)
        if not self._telemetry.armed or self._telemetry.on_ground:
            raise AutopilotRefused(step, "the vehicle stands on the ground; nothing was sent")

    @abstractmethod
    async def _land_in(self, step: str, mode: str, *, timeout_s: float) -> None:
        """Has it come down in that mode; returns on touchdown."""

    @abstractmethod
    def _ask_why_not_armable(self) -> None:
        """Has the vehicle say what keeps it from being armed."""

    def _may_be_armed(self) -> bool:
        """Whether its checks pass in the mode to be flown, or somebody else has it, which ends the wait too."""
        telemetry = self._telemetry
        ready = telemetry.can_be_armed and telemetry.knows_its_place and not self._where.restless
        return bool(ready) or not self._vehicle.is_ours

    def _reasons_since(self, since_s: float) -> tuple[str, ...]:
        texts = [text.text for said_s, text in self._telemetry.texts if said_s >= since_s]
        reasons = (text.partition(": ")[2] for text in texts if text.startswith(("PreArm: ", "Arm: ")))
        return tuple(dict.fromkeys(reasons))

    def _own_reasons(self) -> tuple[str, ...]:
        """What its reports say where it gives no reason: its checks may pass in a mode that needs no position."""
        if self._where.restless:
            return (self._where.restless,)
        unsure = self._telemetry.can_be_armed and not self._telemetry.knows_its_place
        return ("it does not know its position yet",) if unsure else ()

    async def _know_home(self) -> None:
        """Asks for its home where it has not told it."""
        for _ in range(self._settings.patience.attempts):
            if self._telemetry.home is not None:
                return
            self._vehicle.ask_for(_HOME_POSITION)
            await self._vehicle.happens(
                "home", lambda: self._telemetry.home is not None, within_s=self._settings.patience.answer_s
            )

    async def _while_ours(self, step: str, done: Callable[[], bool]) -> None:
        """Returns when it is done; raises where the vehicle is lost to somebody, or stops its motors, first."""
        vehicle = self._vehicle
        await vehicle.until(step, lambda: done() or not vehicle.is_ours or not self._telemetry.armed)
        if done():
            return
        vehicle.require_control(step)
        raise AutopilotRefused(step, "the vehicle disarmed", vehicle.said_lately)

    def _arrived(self, target: Position) -> bool:
        return self._rests_at(target) and self._where.is_sure

    def _rests_at(self, target: Position) -> bool:
        """By its own report, which a hold has to go by: it may be in doubt of its place for long."""
        return distance_m(self.position, target) <= self._settings.arrival_distance_m and self._at_rest()

    def _climbed(self, altitude_m: float) -> bool:
        """At rest at the altitude, and known to fly: what it says of that may come later than its position."""
        missing_m = altitude_m - self.position.altitude_m
        near = missing_m <= self._settings.arrival_distance_m
        return near and self._at_rest() and self._telemetry.in_the_air

    def _at_rest(self) -> bool:
        return self._telemetry.speed_m_s < self._settings.arrival_speed_m_s

    def _landed(self, since_s: float) -> bool:
        """By a landed state since then; where it tells none, by its motors, which it stops after touchdown."""
        if self._telemetry.stands is None:
            return not self._telemetry.armed
        return self.stands and self._vehicle.heard_since(_EXTENDED_SYS_STATE, since_s)

    async def _touch_down(self, step: str, begun_s: float) -> None:
        """Returns on touchdown; raises where the vehicle is lost, or its motors stop in the air, before."""
        vehicle, told = self._vehicle, self._telemetry
        vehicle.latch.expect_armed(False)  # it disarms itself some time after touchdown

        def falls() -> bool:
            seen = vehicle.heard_since(_POSITION, told.disarmed_s + _FALL_SEEN_S)
            return not told.armed and told.disarmed_s >= begun_s and seen and self._may_fall()

        await vehicle.until(step, lambda: self._landed(begun_s) or falls() or not vehicle.is_ours)
        if not self._landed(begun_s):
            vehicle.require_control(step)
            raise AutopilotRefused(step, "its motors stopped in the air", vehicle.said_lately)

    def _inside(self, circles: Sequence[Circle]) -> list[bool]:
        return [circle.contains(self.position) for circle in circles]

    def _leg_s(self, end: Position) -> float:
        """The longest that a flight to there may take."""
        slowest_m_s = self._ground_speed_m_s * self._settings.slowest_share
        rise_m = abs(end.altitude_m - self.position.altitude_m)
        return ground_distance_m(self.position, end) / slowest_m_s + self._vertical_s(rise_m)

    def _vertical_s(self, height_m: float) -> float:
        return self._settings.margin_s + height_m / self._settings.slowest_vertical_m_s


def check_speed(ground_speed_m_s: float) -> None:
    """Raises UsageError for what is no speed."""
    if not ground_speed_m_s > 0:
        raise UsageError(f"the ground speed is {ground_speed_m_s} m/s; give a number above 0")
