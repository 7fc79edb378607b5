"""PROGRAM: the Drone that a mission sees, and the flight around it."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import msgspec

from upwash.config import DroneConfig, ending, geofence, server_area, waypoints
from upwash.core.control import Control
from upwash.core.estimates import Operation
from upwash.core.geo import Position, Waypoint
from upwash.core.geofence import breached_by_leg, breached_by_position
from upwash.core.happenings import Arrived, CourseLost, Happening, LegBegun
from upwash.core.selection import Selection
from upwash.errors import (
    AutopilotError,
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
from upwash.ports import (
    ArmingDelayed,
    Autopilot,
    Camera,
    Dialer,
    InstanceSpec,
    Journal,
    LinkChanged,
    Network,
    Notifier,
    Program,
    Runtime,
    VehicleLimits,
    VehicleNews,
    VehicleSetting,
    VehicleText,
)
from upwash.preparation import contacts, make_hedging, make_selection
from upwash.reserve import ReserveWatch
from upwash.safety import end_safely, follow
from upwash.service import Method, make_stub, spec_of
from upwash.site import Site

_WORDS_KEPT = 8  # of the vehicle's, to say with whom it was lost to
_WORDS_BEFORE_S = 1.0  # they come with the report that shows the loss

T = TypeVar("T")
Mission = Callable[["Drone"], None]


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
        site: Site,
        tell: Callable[[Happening], None],
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

    def found_flying(self) -> None:
        """The vehicle is in the air, where another program left it."""
        self._in_the_air = self._found_flying = True

    def arm(self) -> None:
        """Waits until the vehicle is ready to fly, then arms its motors.

        AutopilotRefused where the vehicle stands too far from the mission, or its own fence forbids a part of it.
        """
        if not self._found_flying:  # arming would change the mode that it flies in
            self._thread.call(self._logged(self._arm, "armed"))

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
        self._on_a_leg = True
        try:
            await self._autopilot.goto(position)
        finally:
            self._on_a_leg = False
        self._stands_at = position
        self._tell(Arrived())
        self._journal.record("arrived", **where)

    async def _arm(self) -> None:
        await self._autopilot.ready()
        limits = await self._autopilot.limits()
        self._record_limits(limits)
        self._site.require_reachable(self._autopilot.position)
        self._site.require_within(limits)
        await self._autopilot.arm()

    def _record_limits(self, limits: VehicleLimits) -> None:
        self._journal.record(
            "vehicle_limits",
            home=rounded(limits.home) if limits.home else None,
            highest_m=limits.highest_m,
            fences=[fence.name for fence in limits.fences],
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


def _why(error: BaseException) -> str:
    """What an error says, in words for those that say nothing."""
    if isinstance(error, asyncio.CancelledError):
        return "the program was stopped at once"
    return str(error) or type(error).__name__


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
        self._stop_following = asyncio.Event()
        self._last_words: deque[tuple[float, VehicleText]] = deque(maxlen=_WORDS_KEPT)  # with their times
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
            site=Site(
                waypoints=self._plan,
                fences=geofence(config.mission),
                farthest_start_m=config.autopilot.farthest_start_m,
            ),
            tell=self._offloading.tell,
        )

    async def run(self) -> None:
        """Flies the mission; raises what ended it, after the configured action where the vehicle obeys."""
        journal, config = self._world.journal, self._config
        try:
            self._world.autopilot.listen(self._hear_vehicle)
            await self._take_vehicle()
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
            journal.record("mission_ended", why=_why(error))
            raise
        finally:
            await self._release_dead_man()
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
        """Ends the mission early, in the configured action; where the vehicle is not ours, ends following it."""
        self._stopped = self._stopped or why
        self._world.journal.record("stopping", why=why)
        self._thread.stop(why)
        self._stop_following.set()

    def _hear_vehicle(self, news: VehicleNews) -> None:
        journal = self._world.journal
        match news:
            case VehicleText(severity, text):
                journal.record("vehicle_said", severity=severity, text=text)
                self._last_words.append((asyncio.get_running_loop().time(), news))
            case VehicleSetting(name, value, advice):
                journal.record("vehicle_setting", name=name, value=value, advice=advice)
            case LinkChanged(linked, silent_s):
                journal.record("link_restored" if linked else "link_lost", silent_s=round(silent_s, 1))
            case ArmingDelayed(reasons):
                journal.record("arming_delayed", reasons=list(reasons))
            case Control(owner, _, why):
                journal.record("control", owner=owner, why=why)
                if not news.is_ours:
                    self._thread.stop(str(news))

    async def _take_vehicle(self) -> None:
        """Refuses to begin a mission in the air, and takes up one that was broken off there."""
        autopilot = self._world.autopilot
        flies = await autopilot.in_the_air()
        if flies and self._done is None:
            raise AutopilotRefused(
                "start",
                "the vehicle is in the air: land it first, or take up the flight that was broken off with "
                "--resume and its event log; nothing was sent",
            )
        await autopilot.claim(resumes=self._done is not None)
        if flies:
            self._pilot.found_flying()
        await self._set_dead_man(flies=flies)

    async def _set_dead_man(self, *, flies: bool) -> None:
        """Has the autopilot miss this program; where it cannot, only a vehicle that flies already goes on."""
        settings, journal = self._config.autopilot, self._world.journal
        if (
            settings.dead_man_s is None or settings.on_failure == "hold"
        ):  # the two together are refused in a file
            return
        try:
            await self._world.autopilot.dead_man.watch(
                silence_s=settings.dead_man_s, action=settings.on_failure
            )
            journal.record("dead_man_set", silence_s=settings.dead_man_s, action=settings.on_failure)
        except AutopilotOverruled:
            raise
        except AutopilotError as error:
            if not flies:
                raise
            journal.record("dead_man_failed", why=str(error))

    async def _release_dead_man(self) -> None:
        """Says goodbye, unless the vehicle is left hovering: then the autopilot is to bring it down."""
        autopilot = self._world.autopilot
        if autopilot.stands or not autopilot.control.is_ours:
            await autopilot.dead_man.release()

    async def _start_services(self) -> None:
        try:
            await self._onboard.start()
        except (Exception, asyncio.CancelledError) as error:
            await self._end(_why(error))
            raise

    async def _fly(self) -> None:
        try:
            await self._run_mission()
        except (Exception, asyncio.CancelledError) as error:
            await self._end(_why(error))
            raise
        await self._end("the mission ended in the air")

    async def _run_mission(self) -> None:
        watch = asyncio.create_task(self._watch_battery())
        try:
            await self._thread.run(lambda: self._program()(self._drone()))
        except UpwashError:
            self._require_control()
            raise
        except Exception as error:
            raise mission_failed(error) from error
        finally:
            watch.cancel()
        self._require_control()
        if self._stopped:  # though the mission made nothing of it
            raise MissionStopped(self._stopped)

    def _program(self) -> Mission:
        if self._plan or self._done is None:
            return self._mission
        return _come_down if self._pilot.in_the_air else _stay_down

    def _require_control(self) -> None:
        """Says what ended the mission where the vehicle was lost to somebody: not what the verb then raised."""
        control = self._world.autopilot.control
        if not control.is_ours:
            since_s = control.since_s - _WORDS_BEFORE_S
            words = [text.text for said_s, text in self._last_words if said_s >= since_s]
            raise AutopilotOverruled("mission", str(control), "; ".join(dict.fromkeys(words)))

    async def _end(self, why: str) -> None:
        """Ends what is under way safely, while the vehicle is ours; follows it to the ground otherwise."""
        autopilot, journal = self._world.autopilot, self._world.journal
        if autopilot.control.is_ours and (self._pilot.in_the_air or autopilot.armed):
            self._stop_following.clear()
            await end_safely(autopilot, self._config.autopilot.on_failure, journal, why=why)
        if not autopilot.control.is_ours:
            await follow(autopilot, journal, until=self._stop_following)

    async def _watch_battery(self) -> None:
        """Stops the mission at the reserve, unless it is bringing the vehicle to the ground already."""
        pilot, default_m_s = self._pilot, self._config.mission.ground_speed_m_s
        watch = ReserveWatch(
            self._config,
            self._world.autopilot,
            self._world.journal,
            flying=lambda: pilot.in_the_air,
            leg_speed_m_s=lambda: (pilot.ground_speed_m_s or default_m_s) if pilot.on_a_leg else None,
        )
        why = await watch.reached()
        if not pilot.coming_down:
            self.stop(why)

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
