"""The autopilot over MAVLink: an ArduCopter, steered in GUIDED.

The vehicle may be taken from the mission at any time by a pilot's switch or by its own fail-safe. It shows as a
change of mode; the verb in progress then raises, and none takes the vehicle back except `arm`, `hold`, `land`
and `return_home_and_land`, which are explicit about the mode they want.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Circle, LocalFrame, Position, distance_m, ground_distance_m
from upwash.errors import AutopilotOverruled, AutopilotRefused, AutopilotTimeout, UsageError
from upwash.real.copter import Copter, Patience

_GUIDED = mavlink.COPTER_MODE_GUIDED
_RTL = mavlink.COPTER_MODE_RTL
_LAND = mavlink.COPTER_MODE_LAND
_HOME = Position(0.0, 0.0)
_LIFT_REPORT_S = 1.0  # for a report that it has left the ground, while some get lost


@dataclass(frozen=True, slots=True)
class FlightSettings:
    """When a verb is true, and when it has taken too long."""

    arrival_distance_m: float = 1.0
    arrival_speed_m_s: float = 0.5
    progress_m: float = 0.5
    progress_s: float = 3.0  # a target is repeated when the vehicle came not so much nearer in so long
    speed_tolerance: float = 1.1  # of the ground speed, above which it is told again
    speed_again_s: float = 5.0
    ready_timeout_s: float = 120.0  # for the checks before arming
    arm_again_s: float = 2.0
    margin_s: float = 60.0  # a flight may take so long, plus its distance at the slowest speeds below
    slowest_share: float = 1 / 3  # of the ground speed, against the wind
    slowest_vertical_m_s: float = 0.4
    return_altitude_m: float = 100.0  # the vehicle may climb so high before it returns
    patience: Patience = field(default_factory=Patience)


DEFAULT_SETTINGS = FlightSettings()


async def connect_autopilot(
    connection: str,
    *,
    frame: LocalFrame,
    ground_speed_m_s: float,
    heartbeat_timeout_s: float = 10.0,
    settings: FlightSettings = DEFAULT_SETTINGS,
) -> MavlinkAutopilot:
    """Returns once an autopilot has been heard on the connection; raises AutopilotError if none is.

    `connection` is `udpin:HOST:PORT`, `udpout:HOST:PORT`, `tcp:HOST:PORT` or `serial:DEVICE:BAUD`.
    """
    _check_speed(ground_speed_m_s)
    copter = Copter(connection, settings.patience)
    try:
        await copter.found(within_s=heartbeat_timeout_s)
    except BaseException:
        await copter.close()
        raise
    return MavlinkAutopilot(copter, frame=frame, ground_speed_m_s=ground_speed_m_s, settings=settings)


class MavlinkAutopilot:
    """ports.Autopilot for an ArduCopter that has been heard."""

    def __init__(
        self,
        copter: Copter,
        *,
        frame: LocalFrame,
        ground_speed_m_s: float,
        settings: FlightSettings = DEFAULT_SETTINGS,
    ) -> None:
        self._copter = copter
        self._vehicle = copter.telemetry
        self._frame = frame
        self._settings = settings
        self._ground_speed_m_s = ground_speed_m_s
        # ArduCopter accepts a speed before a flight's first target, and loses it: it is told once the first
        # target is seen to be flown to.
        self._obeys_speed = False
        self._told_speed_s = -math.inf

    @property
    def battery_percent(self) -> float | None:
        """How full the battery is, as the vehicle reports it; None while it does not."""
        return self._vehicle.battery_percent

    @property
    def vehicle_said(self) -> str:
        """What the vehicle last said in words."""
        return self._vehicle.said

    @property
    def linked(self) -> bool:
        """Whether the vehicle has been heard lately."""
        return self._copter.linked

    async def link_lost(self) -> None:
        """Returns when the vehicle has not been heard for `patience.quiet_after_s`, which is below 3 s."""
        await self._copter.link_lost()

    async def link_restored(self) -> None:
        """Returns when the vehicle is heard again."""
        await self._copter.link_restored()

    @property
    def position(self) -> Position:
        """The last known position, relative to the mission's home; home until the vehicle knows its own."""
        geo = self._vehicle.position
        return self._frame.position(geo) if geo else _HOME

    async def in_the_air(self) -> bool:
        """Whether it flies in GUIDED; AutopilotOverruled if it flies in any other mode."""
        async with self._within("start", self._settings.margin_s):
            await self._copter.until("start", self._tells_whether_it_flies)
        if self._vehicle.armed and self._vehicle.in_the_air:
            self._require_mode("start", (_GUIDED,))
            return True
        return False

    def _tells_whether_it_flies(self) -> bool:
        vehicle = self._vehicle
        told = vehicle.on_ground or vehicle.in_the_air
        return not vehicle.armed or (told and vehicle.position is not None)

    async def arm(self) -> None:
        """Waits until the vehicle is ready to fly, then arms its motors; AutopilotRefused has its reason if not."""
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + self._settings.ready_timeout_s
        async with self._within("arm", self._settings.ready_timeout_s + self._settings.margin_s):
            while True:
                try:
                    await self._enter_guided("arm")
                    await self._copter.arm("arm", armed=True)
                    break
                except AutopilotRefused:
                    if loop.time() + self._settings.arm_again_s > deadline_s:
                        raise
                await asyncio.sleep(self._settings.arm_again_s)
            await self._copter.until(
                "arm", lambda: self._vehicle.armed and self._vehicle.position is not None
            )

    async def takeoff(self, altitude_m: float) -> None:
        """Climbs to the altitude above home; returns when it is reached."""
        step = f"takeoff to {altitude_m:g} m"
        self._obeys_speed = False
        async with self._within(step, self._vertical_s(altitude_m)):
            await self._lift_off(step, altitude_m)
            await self._flown(step, lambda: self._climbed(altitude_m), modes=(_GUIDED,))

    async def _lift_off(self, step: str, altitude_m: float) -> None:
        """Commands the take-off; a repeated command is refused in the air, where only its answer was lost."""
        flew = self._vehicle.in_the_air
        try:
            await self._copter.command(step, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, altitude_m)
        except AutopilotRefused:
            if flew or not await self._copter.happens(
                step, lambda: self._vehicle.in_the_air, within_s=_LIFT_REPORT_S
            ):
                raise

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Sets the speed of the legs that follow."""
        _check_speed(ground_speed_m_s)
        self._ground_speed_m_s = ground_speed_m_s
        if self._obeys_speed:
            await self._tell_speed("set ground speed")

    async def goto(self, position: Position) -> None:
        """Flies to the position; returns on arrival, at rest."""
        step = f"goto {position.east_m:.1f} m east, {position.north_m:.1f} m north"
        async with self._within(step, self._leg_s(position)):
            self._require_mode(step, (_GUIDED,))
            self._send_target(position)
            await self._arrival(step, position)

    async def hold(self) -> None:
        """Stops and hovers where it is."""
        async with self._within("hold", self._settings.margin_s):
            if self._vehicle.mode != _GUIDED:
                await self._enter_guided("hold")
            here = self.position
            self._send_target(here)
            await self._arrival("hold", here)

    async def return_home_and_land(self) -> None:
        """Flies back to where it took off and lands; returns on touchdown."""
        altitude_m = max(self.position.altitude_m, self._settings.return_altitude_m)
        home_s = self._leg_s(_HOME) + 2 * self._vertical_s(altitude_m)
        await self._land_in("return home and land", _RTL, timeout_s=home_s)

    async def land(self) -> None:
        """Lands where it is; returns on touchdown."""
        await self._land_in("land", _LAND, timeout_s=self._vertical_s(self.position.altitude_m))

    async def disarm(self) -> None:
        """Stops the motors; refused by the vehicle in flight."""
        async with self._within("disarm", self._settings.margin_s):
            await self._copter.arm("disarm", armed=False)

    async def border_crossed(self, circles: Sequence[Circle]) -> None:
        """Returns when the vehicle next enters or leaves any of the circles."""
        before = self._inside(circles)
        await self._copter.until("watch the borders", lambda: self._inside(circles) != before)

    async def close(self) -> None:
        """Gives up the connection to the vehicle; the vehicle is left as it is."""
        await self._copter.close()

    @asynccontextmanager
    async def _within(self, step: str, timeout_s: float) -> AsyncIterator[None]:
        try:
            async with asyncio.timeout(timeout_s):
                yield
        except TimeoutError:
            problem = f"not done within {timeout_s:.0f} s, in mode {self._vehicle.mode_name}"
            raise AutopilotTimeout(step, problem, self._vehicle.said) from None

    async def _land_in(self, step: str, mode: int, *, timeout_s: float) -> None:
        begun_s = asyncio.get_running_loop().time()
        async with self._within(step, timeout_s):
            await self._copter.change_mode(step, mode)
            await self._flown(step, lambda: self._landed(begun_s), modes=(mode, _LAND))

    async def _flown(self, step: str, done: Callable[[], bool], *, modes: tuple[int, ...]) -> None:
        """Returns when it is done; raises if the vehicle leaves the modes or stops its motors first."""
        vehicle = self._vehicle
        await self._copter.until(step, lambda: done() or vehicle.mode not in modes or not vehicle.armed)
        if done():
            return
        self._require_mode(step, modes)
        raise AutopilotRefused(step, "the vehicle disarmed", vehicle.said)

    async def _arrival(self, step: str, target: Position) -> None:
        """Returns on arrival; repeats the target, which may have been lost, while the vehicle comes no nearer."""
        while not self._arrived(target):
            near_m = distance_m(self.position, target) - self._settings.progress_m

            def changed(near_m: float = near_m) -> bool:
                return (
                    self._arrived(target)
                    or self._vehicle.mode != _GUIDED
                    or distance_m(self.position, target) <= near_m
                )

            progress = await self._copter.happens(step, changed, within_s=self._settings.progress_s)
            self._require_mode(step, (_GUIDED,))
            if not progress:
                self._send_target(target)
            elif not self._obeys_speed or self._is_too_fast():
                await self._tell_speed(step)
                self._obeys_speed = True

    def _arrived(self, target: Position) -> bool:
        near = distance_m(self.position, target) <= self._settings.arrival_distance_m
        return near and self._at_rest()

    def _climbed(self, altitude_m: float) -> bool:
        """At rest at the altitude, and known to fly: what it says of that may come later than its position."""
        missing_m = altitude_m - self.position.altitude_m
        return missing_m <= self._settings.arrival_distance_m and self._at_rest() and self._vehicle.in_the_air

    def _at_rest(self) -> bool:
        return self._vehicle.speed_m_s < self._settings.arrival_speed_m_s

    def _landed(self, since_s: float) -> bool:
        """Whether it says so, not whether it last did: the reports may have stopped before the take-off."""
        told = self._copter.heard_since(mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, since_s)
        return (told and self._vehicle.on_ground) or not self._vehicle.armed

    def _inside(self, circles: Sequence[Circle]) -> list[bool]:
        return [circle.contains(self.position) for circle in circles]

    def _require_mode(self, step: str, modes: tuple[int, ...]) -> None:
        if self._vehicle.mode not in modes:
            problem = (
                f"the vehicle is in mode {self._vehicle.mode_name}: the pilot or a fail-safe has taken over"
            )
            raise AutopilotOverruled(step, problem, self._vehicle.said)

    def _send_target(self, position: Position) -> None:
        self._copter.send_target(self._frame.geo(position))

    def _is_too_fast(self) -> bool:
        """Whether it still flies faster than it was told a while ago."""
        settings, now_s = self._settings, asyncio.get_running_loop().time()
        limit_m_s = self._ground_speed_m_s * settings.speed_tolerance + settings.arrival_speed_m_s
        too_fast = self._vehicle.ground_speed_m_s > limit_m_s
        return too_fast and now_s - self._told_speed_s > settings.speed_again_s

    async def _enter_guided(self, step: str) -> None:
        await self._copter.change_mode(step, _GUIDED)
        self._obeys_speed = False

    async def _tell_speed(self, step: str) -> None:
        self._told_speed_s = asyncio.get_running_loop().time()
        over_ground, same_throttle = mavlink.SPEED_TYPE_GROUNDSPEED, -1
        await self._copter.command(
            step, mavlink.MAV_CMD_DO_CHANGE_SPEED, over_ground, self._ground_speed_m_s, same_throttle
        )

    def _leg_s(self, end: Position) -> float:
        """The longest that a flight to there may take."""
        slowest_m_s = self._ground_speed_m_s * self._settings.slowest_share
        rise_m = abs(end.altitude_m - self.position.altitude_m)
        return ground_distance_m(self.position, end) / slowest_m_s + self._vertical_s(rise_m)

    def _vertical_s(self, height_m: float) -> float:
        return self._settings.margin_s + height_m / self._settings.slowest_vertical_m_s


def _check_speed(ground_speed_m_s: float) -> None:
    if not ground_speed_m_s > 0:
        raise UsageError(f"the ground speed is {ground_speed_m_s} m/s; give a number above 0")
