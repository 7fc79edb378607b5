"""What a mission flies with: the drone, its vehicle, camera, user and services."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

import msgspec

from upwash.core.estimates import Operation
from upwash.core.events import Arrived, Event, LegBegun, MissionBegun, TargetUnknown
from upwash.core.geo import Position, Waypoint
from upwash.core.geofence import breached_by_leg, breached_by_position
from upwash.drone.mission import MissionThread
from upwash.drone.site import Site
from upwash.errors import AutopilotRefused, UsageError
from upwash.eventlog import schema
from upwash.plans import Ending
from upwash.ports import Autopilot, Camera, Journal, Notifier, VehicleLimits
from upwash.rpc.service import Method, make_stub, spec_of

T = TypeVar("T")
Mission = Callable[["Drone"], None]
_AtPlace = type[
    schema.Armed | schema.Holding | schema.Returning | schema.Landing | schema.Landed | schema.Disarmed
]


class Vehicle:
    """The vehicle as a mission uses it: each verb blocks until it is true, and raises AutopilotError otherwise."""

    def __init__(
        self,
        autopilot: Autopilot,
        thread: MissionThread,
        journal: Journal,
        *,
        site: Site,
        tell: Callable[[Event], None],
    ) -> None:
        self._autopilot = autopilot
        self._thread = thread
        self._journal = journal
        self._site = site
        self._tell = tell
        self._in_the_air = False
        self._found_flying = False  # it has taken off before this program began, and not landed since
        self._coming_down = False
        self._ground_speed_m_s: float | None = None  # as it was last set
        self._on_a_leg = False
        self._stands_at: Position | None = None  # where exactly it was sent, which is not quite where it is

    @property
    def position(self) -> Position:
        """Where the drone is, relative to the mission's home."""
        return self._autopilot.position

    @property
    def in_the_air(self) -> bool:
        """Whether the mission has taken off and not landed since."""
        return self._in_the_air

    @property
    def coming_down(self) -> bool:
        """Whether the mission is bringing the vehicle to the ground."""
        return self._coming_down

    @property
    def battery_percent(self) -> float | None:
        """What is left in the battery, as last reported; None where the vehicle does not say."""
        return self._autopilot.battery_percent

    @property
    def on_a_leg(self) -> bool:
        """Whether it is on its way to where the mission sent it."""
        return self._on_a_leg

    @property
    def ground_speed_m_s(self) -> float | None:
        """The speed of legs, as the mission last set it; None for that of the configuration."""
        return self._ground_speed_m_s

    def _take_up(self) -> None:
        """The vehicle is in the air, where another program left it: for the flight to say, not for a mission."""
        self._in_the_air = self._found_flying = True
        self._tell(MissionBegun(self._autopilot.energy))

    def arm(self) -> None:
        """Waits until the vehicle is ready to fly, then arms its motors.

        AutopilotRefused where the vehicle stands too far from the mission, or its own fence forbids a part of it.
        """
        if not self._found_flying:  # arming would change the mode that it flies in
            self._thread.call(self._logged(self._arm, schema.Armed))

    def takeoff(self, altitude_m: float) -> None:
        """Climbs to the altitude above home; one that was found flying climbs where it is, if it is lower."""
        if self._found_flying:
            self._thread.call(self._climb(altitude_m))
            return
        self._stands_at = None
        self._in_the_air = True  # from the attempt on: it may fail half-way up
        self._thread.call(self._takeoff(altitude_m))

    def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Sets the speed of the legs that follow."""
        self._thread.call(self._set_ground_speed(ground_speed_m_s))

    def goto(self, place: Waypoint | Position) -> None:
        """Flies to a waypoint or position; returns on arrival, at rest.

        AutopilotRefused for a place that the plan's geofence keeps the vehicle from; it does not move then.
        """
        if isinstance(place, Waypoint):
            verb = self._goto(place.position, waypoint=place.index, ground_speed_m_s=place.ground_speed_m_s)
        else:
            verb = self._goto(place)
        self._thread.call(verb)

    def hold(self) -> None:
        """Stops and hovers."""
        self._stands_at = None
        self._thread.call(self._logged(self._autopilot.hold, schema.Holding))

    def return_home_and_land(self) -> None:
        """Flies back to where it took off and lands."""
        self._come_down(self._autopilot.return_home_and_land, schema.Returning)

    def land(self) -> None:
        """Lands where it is."""
        self._come_down(self._autopilot.land, schema.Landing)

    def disarm(self) -> None:
        """Stops the motors."""
        self._thread.call(self._logged(self._autopilot.disarm, schema.Disarmed))

    def _come_down(self, verb: Callable[[], Coroutine[Any, Any, None]], doing: _AtPlace) -> None:
        self._coming_down = True
        try:
            self._thread.call(self._logged(verb, schema.Landed, before=doing))
            self._in_the_air = self._found_flying = False
        finally:
            self._coming_down = False

    async def _set_ground_speed(self, ground_speed_m_s: float) -> None:
        await self._autopilot.set_ground_speed(ground_speed_m_s)
        self._ground_speed_m_s = ground_speed_m_s

    async def _goto(
        self, position: Position, *, waypoint: int | None = None, ground_speed_m_s: float | None = None
    ) -> None:
        self._require_allowed(position)
        if ground_speed_m_s is not None and ground_speed_m_s != self._ground_speed_m_s:
            await self._set_ground_speed(ground_speed_m_s)
        self._journal.record(schema.Leg(waypoint=waypoint, east_m=position.east_m, north_m=position.north_m))
        self._tell(LegBegun(position, self._ground_speed_m_s))
        self._stands_at = None
        self._on_a_leg = True
        try:
            await self._autopilot.goto(position)
        finally:
            self._on_a_leg = False
        self._stands_at = position
        self._tell(Arrived())
        self._journal.record(
            schema.Arrived(waypoint=waypoint, east_m=position.east_m, north_m=position.north_m)
        )

    async def _arm(self) -> None:
        await self._autopilot.ready()
        limits = await self._autopilot.limits()
        self._record_limits(limits)
        self._site.require_reachable(self._autopilot.position)
        self._site.require_within(limits)
        await self._autopilot.arm()
        self._tell(MissionBegun(self._autopilot.energy))

    def _record_limits(self, limits: VehicleLimits) -> None:
        self._journal.record(
            schema.VehicleLimits(
                home=rounded(limits.home) if limits.home else None,
                highest_m=limits.highest_m,
                fences=[fence.name for fence in limits.fences],
            )
        )

    def _require_allowed(self, target: Position) -> None:
        start = self._stands_at or self._autopilot.position
        fences = self._site.fences
        fence = breached_by_position(fences, target)
        if fence is None and breached_by_position(fences, start) is None:  # else it has to come back in
            fence = breached_by_leg(fences, start, target)
        if fence is not None:
            step = f"goto {target.east_m:.1f} m east, {target.north_m:.1f} m north"
            raise AutopilotRefused(
                step, f"{fence.name} of the plan's geofence is in the way; nothing was sent"
            )

    async def _takeoff(self, altitude_m: float) -> None:
        self._tell(TargetUnknown())
        await self._autopilot.takeoff(altitude_m)
        self._journal.record(
            schema.TookOff(altitude_m=altitude_m, position=rounded(self._autopilot.position))
        )

    async def _climb(self, altitude_m: float) -> None:
        here = self._autopilot.position
        if here.altitude_m < altitude_m:  # never down: only the plan knows what is below
            await self._autopilot.goto(Position(here.east_m, here.north_m, altitude_m))

    async def _logged(
        self,
        verb: Callable[[], Coroutine[Any, Any, None]],
        after: _AtPlace,
        *,
        before: _AtPlace | None = None,
    ) -> None:
        self._tell(TargetUnknown())
        if before is not None:
            self._journal.record(before(position=rounded(self._autopilot.position)))
        await verb()
        self._journal.record(after(position=rounded(self._autopilot.position)))


class Photographer:
    """The camera as a mission uses it."""

    def __init__(
        self, camera: Camera, thread: MissionThread, journal: Journal, *, position: Callable[[], Position]
    ) -> None:
        self._camera = camera
        self._thread = thread
        self._journal = journal
        self._position = position

    def take_photo(self) -> bytes:
        """Shoots and returns one JPEG; raises CameraError."""
        return self._thread.call(self._take_photo())

    async def _take_photo(self) -> bytes:
        at = self._position()
        photo = await self._camera.take_photo(at)
        self._journal.record(
            schema.Photo(
                source=photo.source,
                bytes=len(photo.jpeg),
                age_s=round(asyncio.get_running_loop().time() - photo.captured_s, 6),
                position=rounded(at),
                truth=msgspec.to_builtins(photo.truth),
            )
        )
        return photo.jpeg


class User:
    """The drone's user as a mission knows them."""

    def __init__(self, notifier: Notifier, thread: MissionThread) -> None:
        self._notifier = notifier
        self._thread = thread

    def notify(self, message: object, at: Waypoint | Position) -> None:
        """Tells the user about something found at a waypoint or position."""
        position = at.position if isinstance(at, Waypoint) else at
        self._thread.call(self._notifier.notify(message, position))


class Drone:
    """What a mission program flies with.

    `plan` holds the waypoints that are to be visited, in flight order, and `altitude_m` is the altitude above home
    that the configuration gives.
    """

    plan: tuple[Waypoint, ...]
    altitude_m: float
    autopilot: Vehicle
    camera: Photographer
    user: User

    def __init__(
        self,
        *,
        plan: tuple[Waypoint, ...],
        altitude_m: float,
        ending: Ending,
        autopilot: Vehicle,
        camera: Photographer,
        user: User,
        services: frozenset[str],
        invoke: Callable[[Operation, Method, bytes], Any],
    ) -> None:
        self.plan = plan
        self.altitude_m = altitude_m
        self.autopilot = autopilot
        self.camera = camera
        self.user = user
        self._ending = ending
        self._services = services
        self._invoke = invoke

    def end_flight(self) -> None:
        """Lands where it is if the plan ends so; returns home and lands otherwise."""
        if self._ending == "land":
            self.autopilot.land()
        else:
            self.autopilot.return_home_and_land()

    def service(self, cls: type[T]) -> T:
        """The service, typed as its class; where each of its calls runs is not the mission's concern.

        UsageError for one that the configuration does not name.
        """
        name = spec_of(cls).name
        if name not in self._services:
            raise UsageError(
                f"the mission calls the service {name!r}, which the configuration does not name: add a [[service]] "
                f'table with name = "{name}"; it names {", ".join(sorted(self._services)) or "none"}'
            )
        return make_stub(cls, self._invoke)


def rounded(position: Position) -> Position:
    """To the centimetre."""
    return Position(round(position.east_m, 2), round(position.north_m, 2), round(position.altitude_m, 2))
