"""PROGRAM: the Drone that a mission sees, and the flight around it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import msgspec

from upwash.config import DroneConfig, ending, geofence, server_area, waypoints
from upwash.core.estimates import Operation
from upwash.core.geo import Position, Waypoint, ground_distance_m
from upwash.core.geofence import Fence, breached_by_leg, breached_by_position
from upwash.core.happenings import Arrived, CourseLost, Happening, LegBegun
from upwash.core.selection import Selection
from upwash.errors import (
    AutopilotOverruled,
    AutopilotRefused,
    MissionStopped,
    UpwashError,
    UsageError,
)
from upwash.failsafe import FailSafeOffloading
from upwash.mission import MissionThread, mission_failed
from upwash.offloading import Offloading
from upwash.onboard import OnboardServices
from upwash.plans import Ending
from upwash.ports import Autopilot, Camera, Dialer, InstanceSpec, Journal, Network, Notifier, Program, Runtime
from upwash.preparation import contacts, make_hedging, make_selection
from upwash.safety import end_safely, reserve_reached
from upwash.service import Method, make_stub, spec_of

T = TypeVar("T")
Mission = Callable[["Drone"], None]

_FARTHEST_START_M = (
    10_000.0  # from home; farther away, positions are no longer exact, and a wrong home is likely
)


@dataclass(frozen=True, slots=True)
class World:
    """Everything that a flight needs from outside: things, or models of them; a network for each radio."""

    autopilot: Autopilot
    networks: Sequence[Network]
    dialer: Dialer
    onboard_dialer: Dialer
    onboard_runtime: Runtime
    camera: Camera
    notifier: Notifier
    journal: Journal


class Pilot:
    """The autopilot as a mission uses it: each verb blocks until it is true, and raises AutopilotError otherwise."""

    def __init__(
        self,
        autopilot: Autopilot,
        thread: MissionThread,
        journal: Journal,
        *,
        fences: Sequence[Fence] = (),
        tell: Callable[[Happening], None],
    ) -> None:
        self._autopilot = autopilot
        self._thread = thread
        self._journal = journal
        self._fences = fences
        self._tell = tell
        self._in_the_air = False
        self._found_flying = False  # it has taken off before this program began, and not landed since
        self._coming_down = False
        self._ground_speed_m_s: float | None = None  # as it was last set
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

    def found_flying(self) -> None:
        """The vehicle is in the air, where another program left it."""
        self._in_the_air = self._found_flying = True

    def arm(self) -> None:
        """Waits until the vehicle is ready to fly, then arms its motors."""
        if not self._found_flying:  # arming would change the mode that it flies in
            self._thread.call(self._logged(self._autopilot.arm, "armed"))

    def takeoff(self, altitude_m: float) -> None:
        """Climbs to the altitude above home; AutopilotRefused where the vehicle stands too far from the mission.

        One that was found flying climbs where it is, if it is lower.
        """
        self._require_near_home()
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
        self._thread.call(self._logged(self._autopilot.hold, "holding"))

    def return_home_and_land(self) -> None:
        """Flies back to where it took off and lands."""
        self._come_down(self._autopilot.return_home_and_land, "returning")

    def land(self) -> None:
        """Lands where it is."""
        self._come_down(self._autopilot.land, "landing")

    def disarm(self) -> None:
        """Stops the motors."""
        self._thread.call(self._logged(self._autopilot.disarm, "disarmed"))

    def _come_down(self, verb: Callable[[], Coroutine[Any, Any, None]], doing: str) -> None:
        self._coming_down = True
        try:
            self._thread.call(self._logged(verb, "landed", before=doing))
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
        where = {"waypoint": waypoint, "east_m": position.east_m, "north_m": position.north_m}
        self._journal.record("leg", **where)
        self._tell(LegBegun(position, self._ground_speed_m_s))
        self._stands_at = None
        await self._autopilot.goto(position)
        self._stands_at = position
        self._tell(Arrived())
        self._journal.record("arrived", **where)

    def _require_near_home(self) -> None:
        away_m = ground_distance_m(self._autopilot.position, Position(0.0, 0.0))
        if away_m > _FARTHEST_START_M:
            raise AutopilotRefused(
                "take-off",
                f"the vehicle stands {away_m / 1000:.0f} km from the mission's home; "
                "check mission.home and where the vehicle believes to be; nothing was sent",
            )

    def _require_allowed(self, target: Position) -> None:
        start = self._stands_at or self._autopilot.position
        fence = breached_by_position(self._fences, target)
        if fence is None and breached_by_position(self._fences, start) is None:  # else it has to come back in
            fence = breached_by_leg(self._fences, start, target)
        if fence is not None:
            step = f"goto {target.east_m:.1f} m east, {target.north_m:.1f} m north"
            raise AutopilotRefused(
                step, f"{fence.name} of the plan's geofence is in the way; nothing was sent"
            )

    async def _takeoff(self, altitude_m: float) -> None:
        self._tell(CourseLost())
        await self._autopilot.takeoff(altitude_m)
        self._record("took_off", altitude_m=altitude_m)

    async def _climb(self, altitude_m: float) -> None:
        here = self._autopilot.position
        if here.altitude_m < altitude_m:  # never down: only the plan knows what is below
            await self._autopilot.goto(Position(here.east_m, here.north_m, altitude_m))

    async def _logged(
        self, verb: Callable[[], Coroutine[Any, Any, None]], event: str, *, before: str = ""
    ) -> None:
        self._tell(CourseLost())
        if before:
            self._record(before)
        await verb()
        self._record(event)

    def _record(self, event: str, **facts: object) -> None:
        self._journal.record(event, **facts, position=rounded(self._autopilot.position))


def rounded(position: Position) -> dict[str, float]:
    """To the centimetre."""
    return {name: round(metres, 2) for name, metres in asdict(position).items()}


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
        truth = {} if photo.truth is None else {"truth": photo.truth}
        self._journal.record(
            "photo",
            source=photo.source,
            bytes=len(photo.jpeg),
            age_s=round(asyncio.get_running_loop().time() - photo.captured_s, 6),
            position=rounded(at),
            **truth,
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
    """What a mission program flies with."""

    def __init__(
        self,
        *,
        plan: tuple[Waypoint, ...],
        altitude_m: float,
        ending: Ending,
        autopilot: Pilot,
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


class Flight:
    """One mission from the first check of the services to the landed vehicle.

    With `done` it takes up a mission that was broken off, which has these waypoints behind it: the vehicle may be in
    the air, and the plan holds the other waypoints. Where none is left the vehicle is brought to the ground.
    """

    def __init__(
        self,
        mission: Mission,
        config: DroneConfig,
        *,
        services: Mapping[str, type],
        programs: Mapping[str, Program],
        world: World,
        done: frozenset[int] | None = None,
    ) -> None:
        specs = {name: spec_of(cls) for name, cls in services.items()}
        self._mission = mission
        self._config = config
        self._world = world
        self._thread = MissionThread()
        self._waypoints = waypoints(config.mission)
        self._done = done
        self._plan = tuple(each for each in self._waypoints if each.index not in (done or ()))
        self._stopped = ""  # why, once it is
        self._onboard = OnboardServices(
            [
                InstanceSpec(config.name, service.name, programs[service.name], service.local_pace_s)
                for service in config.services
            ],
            drone=config.name,
            runtime=world.onboard_runtime,
            dialer=world.onboard_dialer,
            journal=world.journal,
        )
        selection: Selection = make_selection(config, specs, self._plan)
        offloading = Offloading(
            selection,
            contacts(config, selection.estimates),
            period_s=config.policy.period_s,
            autopilot=world.autopilot,
            networks=world.networks,
            dialer=world.dialer,
            onboard=self._onboard,
            journal=world.journal,
            hedging=make_hedging(config, selection.estimates),
        )
        self._offloading = FailSafeOffloading(offloading, world.journal)
        self._pilot = Pilot(
            world.autopilot,
            self._thread,
            world.journal,
            fences=geofence(config.mission),
            tell=self._offloading.tell,
        )

    async def run(self) -> None:
        """Flies the mission; raises what ended it, after the configured action where the vehicle obeys."""
        journal, config = self._world.journal, self._config
        try:
            await self._find_vehicle()
            await self._start_services()
            journal.record("planned", **self._planned())
            journal.record(
                "mission_started",
                drone=config.name,
                policy=config.policy.name,
                waypoints=len(self._waypoints),
                done=sorted(self._done or ()),
            )
            async with self._offloading.running():
                await self._fly()
            journal.record("mission_completed")
        except (Exception, asyncio.CancelledError) as error:
            journal.record("mission_ended", why=str(error) or type(error).__name__)
            raise
        finally:
            await self._onboard.close()

    def _planned(self) -> Mapping[str, object]:
        """What a reader of the log needs to draw the flight on a map."""
        mission = self._config.mission
        places = [each.position for each in self._waypoints]
        return {
            "home": msgspec.to_builtins(mission.home),
            "waypoints_m": [(place.east_m, place.north_m) for place in places],
            "ranges": {
                server.name: msgspec.to_builtins(server_area(server, mission.home))
                for server in self._config.servers
            },
            "paced": any(service.local_pace_s for service in self._config.services),
        }

    def stop(self, why: str) -> None:
        """Ends the mission early, in the configured action."""
        self._stopped = self._stopped or why
        self._world.journal.record("stopping", why=why)
        self._thread.stop(why)

    async def _find_vehicle(self) -> None:
        """Refuses to begin a mission in the air, and takes up one that was broken off there."""
        if not await self._world.autopilot.in_the_air():
            return
        if self._done is None:
            raise AutopilotRefused(
                "start",
                "the vehicle is in the air: land it first, or take up the flight that was broken off with "
                "--resume and its event log; nothing was sent",
            )
        self._pilot.found_flying()

    async def _start_services(self) -> None:
        try:
            await self._onboard.start()
        except (Exception, asyncio.CancelledError) as error:
            await self._end_in_the_air(str(error) or type(error).__name__)
            raise

    async def _fly(self) -> None:
        try:
            await self._run_mission()
        except AutopilotOverruled as error:
            self._world.journal.record("left_to_pilot", why=str(error))
            raise
        except (Exception, asyncio.CancelledError) as error:
            await self._end_in_the_air(str(error) or type(error).__name__)
            raise
        await self._end_in_the_air("the mission ended in the air")

    async def _run_mission(self) -> None:
        watch = asyncio.create_task(self._watch_battery())
        try:
            await self._thread.run(lambda: self._program()(self._drone()))
        except UpwashError:
            raise
        except Exception as error:
            raise mission_failed(error) from error
        finally:
            watch.cancel()
        if self._stopped:  # though the mission made nothing of it
            raise MissionStopped(self._stopped)

    def _program(self) -> Mission:
        if self._plan or self._done is None:
            return self._mission
        return _come_down if self._pilot.in_the_air else _stay_down

    async def _end_in_the_air(self, why: str) -> None:
        if self._pilot.in_the_air:
            action = self._config.autopilot.on_failure
            await end_safely(self._world.autopilot, action, self._world.journal, why=why)

    async def _watch_battery(self) -> None:
        """Stops the mission at the reserve, unless it is bringing the vehicle to the ground already."""
        reserve_percent = self._config.mission.reserve_percent
        if reserve_percent is None:
            return
        left_percent = await reserve_reached(self._world.autopilot, reserve_percent, self._world.journal)
        if not self._pilot.coming_down:
            self.stop(
                f"{left_percent:.0f} % is left in the battery, less than the reserve of {reserve_percent:g} %"
            )

    def _drone(self) -> Drone:
        def invoke(operation: Operation, method: Method, request: bytes) -> Any:
            return self._thread.call(self._offloading.invoke(operation, method, request))

        return Drone(
            plan=self._plan,
            altitude_m=self._config.mission.altitude_m,
            ending=ending(self._config.mission),
            autopilot=self._pilot,
            camera=Photographer(
                self._world.camera,
                self._thread,
                self._world.journal,
                position=lambda: self._world.autopilot.position,
            ),
            user=User(self._world.notifier, self._thread),
            services=frozenset(service.name for service in self._config.services),
            invoke=invoke,
        )


def _come_down(drone: Drone) -> None:
    drone.end_flight()
    drone.autopilot.disarm()


def _stay_down(_: Drone) -> None:
    pass
