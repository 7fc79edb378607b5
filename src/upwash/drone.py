"""PROGRAM: the Drone that a mission sees, and the flight around it."""

from __future__ import annotations

import asyncio
import contextlib
import traceback
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from upwash.config import DroneConfig, waypoints
from upwash.core.estimates import Operation
from upwash.core.geo import Position, Waypoint
from upwash.core.selection import Selection
from upwash.errors import AutopilotError
from upwash.mission import MissionThread
from upwash.offloading import Offloading
from upwash.onboard import OnboardServices
from upwash.ports import Autopilot, Camera, Dialer, InstanceSpec, Journal, Network, Notifier, Runtime
from upwash.preparation import contacts, make_selection
from upwash.service import Method, make_stub, spec_of

T = TypeVar("T")
Mission = Callable[["Drone"], None]


@dataclass(frozen=True, slots=True)
class World:
    """Everything that a flight needs from outside: things, or models of them."""

    autopilot: Autopilot
    network: Network
    dialer: Dialer
    onboard_dialer: Dialer
    onboard_runtime: Runtime
    camera: Camera
    notifier: Notifier
    journal: Journal


class Pilot:
    """The autopilot as a mission uses it: each verb blocks until it is true, and raises AutopilotError otherwise."""

    def __init__(self, autopilot: Autopilot, thread: MissionThread, journal: Journal) -> None:
        self._autopilot = autopilot
        self._thread = thread
        self._journal = journal
        self._in_the_air = False

    @property
    def position(self) -> Position:
        """Where the drone is, relative to the mission's home."""
        return self._autopilot.position

    @property
    def in_the_air(self) -> bool:
        """Whether the mission has taken off and not landed since."""
        return self._in_the_air

    def arm(self) -> None:
        """Waits until the vehicle is ready to fly, then arms its motors."""
        self._thread.call(self._logged(self._autopilot.arm, "armed"))

    def takeoff(self, altitude_m: float) -> None:
        """Climbs to the altitude above home."""
        self._in_the_air = True  # from the attempt on: it may fail half-way up
        self._thread.call(self._takeoff(altitude_m))

    def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Sets the speed of the legs that follow."""
        self._thread.call(self._autopilot.set_ground_speed(ground_speed_m_s))

    def goto(self, place: Waypoint | Position) -> None:
        """Flies to a waypoint or position; returns on arrival, at rest."""
        self._thread.call(self._goto(place))

    def hold(self) -> None:
        """Stops and hovers."""
        self._thread.call(self._logged(self._autopilot.hold, "holding"))

    def return_home_and_land(self) -> None:
        """Flies back to where it took off and lands."""
        self._thread.call(self._logged(self._autopilot.return_home_and_land, "landed", before="returning"))
        self._in_the_air = False

    def land(self) -> None:
        """Lands where it is."""
        self._thread.call(self._logged(self._autopilot.land, "landed", before="landing"))
        self._in_the_air = False

    def disarm(self) -> None:
        """Stops the motors."""
        self._thread.call(self._logged(self._autopilot.disarm, "disarmed"))

    async def _goto(self, place: Waypoint | Position) -> None:
        position, index = (place.position, place.index) if isinstance(place, Waypoint) else (place, None)
        where = {"waypoint": index, "east_m": position.east_m, "north_m": position.north_m}
        self._journal.record("leg", **where)
        await self._autopilot.goto(position)
        self._journal.record("arrived", **where)

    async def _takeoff(self, altitude_m: float) -> None:
        await self._autopilot.takeoff(altitude_m)
        self._journal.record("took_off", altitude_m=altitude_m)

    async def _logged(
        self, verb: Callable[[], Coroutine[Any, Any, None]], event: str, *, before: str = ""
    ) -> None:
        if before:
            self._journal.record(before)
        await verb()
        self._journal.record(event)


class Photographer:
    """The camera as a mission uses it."""

    def __init__(self, camera: Camera, thread: MissionThread) -> None:
        self._camera = camera
        self._thread = thread

    def take_photo(self) -> bytes:
        """Shoots and returns one JPEG."""
        return self._thread.call(self._camera.take_photo())


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
        autopilot: Pilot,
        camera: Photographer,
        user: User,
        invoke: Callable[[Operation, Method, bytes], Any],
    ) -> None:
        self.plan = plan
        self.altitude_m = altitude_m
        self.autopilot = autopilot
        self.camera = camera
        self.user = user
        self._invoke = invoke

    def service(self, cls: type[T]) -> T:
        """The service, typed as its class; where each of its calls runs is not the mission's concern."""
        return make_stub(cls, self._invoke)


class Flight:
    """One mission from the first check of the services to the landed vehicle."""

    def __init__(
        self,
        mission: Mission,
        config: DroneConfig,
        *,
        services: Mapping[str, type],
        programs: Mapping[str, str],
        world: World,
    ) -> None:
        specs = {name: spec_of(cls) for name, cls in services.items()}
        self._mission = mission
        self._config = config
        self._world = world
        self._thread = MissionThread()
        self._pilot = Pilot(world.autopilot, self._thread, world.journal)
        self._onboard = OnboardServices(
            [
                InstanceSpec(config.name, service.name, programs[service.name], dict(service.local_pace_s))
                for service in config.services
            ],
            drone=config.name,
            runtime=world.onboard_runtime,
            dialer=world.onboard_dialer,
            journal=world.journal,
        )
        selection: Selection = make_selection(config, specs)
        self._offloading = Offloading(
            selection,
            contacts(config, selection.estimates),
            period_s=config.policy.period_s,
            autopilot=world.autopilot,
            network=world.network,
            dialer=world.dialer,
            onboard=self._onboard,
            journal=world.journal,
        )

    async def run(self) -> None:
        """Flies the mission; raises what ended it, with the vehicle safe on the ground by then where it obeys."""
        journal, config = self._world.journal, self._config
        try:
            await self._onboard.start()
            journal.record("mission_started", drone=config.name, policy=config.policy.name)
            async with self._offloading_in_background():
                await self._fly()
            journal.record("mission_completed")
        except (Exception, asyncio.CancelledError) as error:
            journal.record("mission_ended", why=str(error) or type(error).__name__)
            raise
        finally:
            await self._onboard.close()

    def stop(self, why: str) -> None:
        """Ends the mission early: the vehicle returns and lands."""
        self._world.journal.record("stopping", why=why)
        self._thread.stop(why)

    async def _fly(self) -> None:
        try:
            await self._thread.run(lambda: self._mission(self._drone()))
        except (Exception, asyncio.CancelledError) as error:
            if self._pilot.in_the_air:
                await self._make_safe(str(error) or type(error).__name__)
            raise
        if self._pilot.in_the_air:
            await self._make_safe("the mission ended in the air")

    async def _make_safe(self, why: str) -> None:
        self._world.journal.record("safe_return", why=why)
        try:
            await self._world.autopilot.return_home_and_land()
            self._world.journal.record("landed")
        except AutopilotError as error:
            self._world.journal.record("safe_return_failed", why=str(error))

    @contextlib.asynccontextmanager
    async def _offloading_in_background(self) -> AsyncIterator[None]:
        """A failure of the background ends offloading, not the mission."""
        background = asyncio.create_task(self._offloading.run())
        background.add_done_callback(self._note_failure)
        try:
            yield
        finally:
            if not background.done():
                await self._offloading.end()
            background.cancel()
            with contextlib.suppress(Exception, asyncio.CancelledError):
                await background

    def _note_failure(self, background: asyncio.Task[Any]) -> None:
        if not background.cancelled() and (error := background.exception()) is not None:
            self._world.journal.record("offloading_failed", why="".join(traceback.format_exception(error)))

    def _drone(self) -> Drone:
        def invoke(operation: Operation, method: Method, request: bytes) -> Any:
            return self._thread.call(self._offloading.invoke(operation, method, request))

        return Drone(
            plan=waypoints(self._config.mission),
            altitude_m=self._config.mission.altitude_m,
            autopilot=self._pilot,
            camera=Photographer(self._world.camera, self._thread),
            user=User(self._world.notifier, self._thread),
            invoke=invoke,
        )
