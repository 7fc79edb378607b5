"""PROGRAM: a flight, from the first check of the services to the landed vehicle, around the mission's program."""

from __future__ import annotations

import asyncio
import contextlib
import traceback
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from types import MappingProxyType
from typing import Any

from msgspec.structs import replace

from upwash.config.drone import DroneConfig
from upwash.config.places import demand_map_of, ending, geofence, server_areas
from upwash.config.plan_photos import planned_photos
from upwash.core.camera.georeference import Ground, level_ground
from upwash.core.geo import Circle, Position, rounded
from upwash.core.planning.acts import Acts
from upwash.core.planning.order import Order
from upwash.core.planning.stay_or_go import StayRule
from upwash.core.policies.policy import Policy
from upwash.core.selection.selection import Selection
from upwash.core.vehicle.control import Control
from upwash.drone.answered_photos import AnsweredPhotos
from upwash.drone.answers import AnswerAction
from upwash.drone.api import Drone, Mission, User
from upwash.drone.calls import MissionCalls
from upwash.drone.coming_down import Homecoming, end_safely, follow
from upwash.drone.deadlines import require_deadlines
from upwash.drone.home import planned_home
from upwash.drone.late_acts import LateActs
from upwash.drone.legs import Legs
from upwash.drone.mission import MissionThread, mission_failed
from upwash.drone.objects import FlightObjects
from upwash.drone.offloading import CallPorts
from upwash.drone.payload import Payload
from upwash.drone.photographer import Photographer
from upwash.drone.places import index_of
from upwash.drone.preparation import make_offloading, make_selection, order_of, unkept_deadlines
from upwash.drone.reserve import ReserveWatch
from upwash.drone.rows import Rows
from upwash.drone.seeking import Seeking
from upwash.drone.settling import Settling
from upwash.drone.site import Site
from upwash.drone.sparing import Sparing, SparingAlbum, SparingDialer
from upwash.drone.stops import Stops
from upwash.drone.vehicle import Vehicle
from upwash.errors import (
    AutopilotError,
    AutopilotOverruled,
    AutopilotRefused,
    MissionStopped,
    ReserveReached,
    UpwashError,
)
from upwash.eventlog import schema
from upwash.ports import Album, Autopilot, Camera, ComingDown, Computer, Notifier, Program, VehicleNews
from upwash.rpc.service import Specs, spec_of
from upwash.support.background import end, now_s, only_logged, start
from upwash.support.text import message_of, worded

_LOOKS_AGAIN_S = 1.0  # at the battery, on the way down
_AT_ONCE_S = 1.0  # a person cannot have read of the reserve before
_WORDS_KEPT = 8  # of the vehicle, as a reason of a loss
_WORDS_BEFORE_S = 1.0  # they come with the report that shows the loss


class Ports(CallPorts, frozen=True, kw_only=True):
    """The ports that a flight needs, real or simulated.

    `ground` is the terrain, `album` keeps photos; None keeps none. The program runs on the `computer`; without one
    nothing gets scarce.
    """

    autopilot: Autopilot
    camera: Camera
    notifier: Notifier
    ground: Callable[[Position], Ground] = level_ground
    album: Album | None = None
    computer: Computer | None = None


class Flight:
    """One mission from the first check of the services to the landed vehicle.

    `done` resumes an interrupted mission: these waypoints are complete, the plan has the others, and the vehicle may
    be in the air. If no waypoint is left, the vehicle is brought to the ground. `ordered` is how that mission last
    ordered the vehicle to come down. `order` is the order of the waypoints, decided here if None. `speed_why` is the
    reason of a ground speed that was chosen. `parts` has the programs before sending, by their services' names.
    `policy` stands in for the configured one. `objects` are those that the interrupted mission has acted on.
    """

    def __init__(
        self,
        mission: Mission,
        config: DroneConfig,
        *,
        services: Mapping[str, type],
        programs: Mapping[str, Program],
        ports: Ports,
        parts: Mapping[str, Program] = MappingProxyType({}),
        done: frozenset[int] | None = None,
        ordered: ComingDown | None = None,
        order: Order | None = None,
        speed_why: str = "",
        policy: Policy | None = None,
        objects: FlightObjects | None = None,
    ) -> None:
        self._mission = mission
        self._config = config
        self._sparing = sparing = Sparing(ports.computer, ports.journal)
        self._ports = ports = replace(
            ports,
            dialer=SparingDialer(ports.dialer, sparing),
            album=ports.album and SparingAlbum(ports.album, sparing),
        )
        self._thread = MissionThread()
        specs = {name: spec_of(cls) for name, cls in services.items()}
        self._order = order or order_of(config, specs)
        self._done, self._ordered = done, ordered
        self._plan = tuple(
            waypoint for waypoint in self._order.waypoints if waypoint.index not in (done or ())
        )
        self._stopped: MissionStopped | None = None  # why, once it is
        self._stopped_s = 0.0
        self._ends_safely = False
        self._follows = False  # a vehicle that is not the program's, to the ground
        self.has_ended = False  # its last event is logged
        self._stop_following = asyncio.Event()
        # The vehicle's, with their times.
        self._last_words: deque[tuple[float, schema.VehicleSaid]] = deque(maxlen=_WORDS_KEPT)
        selection = make_selection(config, specs, self._plan, instead=policy)
        self._foreseen: list[schema.Event] = []  # logged before take-off
        if speed_why:
            speed_m_s = config.mission.ground_speed_m_s
            self._foreseen.append(schema.SpeedChosen(ground_speed_m_s=speed_m_s, why=speed_why))
        self._foreseen += (schema.NoBetterAnswer(why=why) for why in unkept_deadlines(config, specs))
        promised = require_deadlines(config, specs, selection.estimates, self._plan)
        self._foreseen += (deadline.event for deadline in promised)
        self.coverage = selection.estimates.coverage  # what is known of servers without a range
        self.demand_map = demand_map_of(config, self._plan)
        self._offloading = make_offloading(config, specs, selection, ports, programs=programs, parts=parts)
        self._homecoming = Homecoming(ports.autopilot, ports.journal)
        self._legs = Legs(
            ports.autopilot,
            ports.journal,
            site=self._site(),
            tell=self._offloading.tell,
            default_m_s=config.mission.ground_speed_m_s,
        )
        self._watch = ReserveWatch(config, self._legs, self._homecoming)
        self._photos = AnsweredPhotos()
        self._settling = self._settles(specs, selection, objects or FlightObjects())
        self._calls = MissionCalls(
            self._thread,
            self._offloading,
            ports.journal,
            waypoint=lambda: index_of(self._legs.place),
            photos=self._photos,
        )

    async def run(self) -> None:
        """Flies the mission; an error that ends it is raised after the configured safe action."""
        journal, config = self._ports.journal, self._config
        try:
            self._ports.autopilot.listen(self._hear_vehicle)
            await self._take_vehicle()
            async with self._ending_safely():
                await self._offloading.start()
            for event in (self._planned(), *self._foreseen):
                journal.record(event)
            journal.record(
                schema.MissionStarted(
                    drone=config.name,
                    policy=config.policy.label,
                    waypoints=len(self._order.waypoints),
                    done=sorted(self._done or ()),
                )
            )
            async with self._offloading.running():
                await self._fly()
            self._log_end(schema.MissionCompleted())
        except (Exception, asyncio.CancelledError) as error:
            self._log_end(schema.MissionEnded(why=_why(error)))
            raise
        finally:
            autopilot = self._ports.autopilot
            if autopilot.stands or not autopilot.control.is_ours:  # else the switch brings down what hovers
                await autopilot.dead_man.release()
            await self._offloading.close()

    def _log_end(self, how: schema.MissionCompleted | schema.MissionEnded) -> None:
        self._ports.journal.record(how)
        self.has_ended = True

    def _site(self) -> Site:
        mission, photos = self._config.mission, planned_photos(self._config.mission)
        return Site(
            waypoints=self._plan,
            fences=geofence(mission),
            farthest_start_m=self._config.autopilot.farthest_start_m,
            takeoff_m=mission.altitude_m,
            ending=ending(mission),
            leaving=photos.leaving,
            way=photos.way,
            home=planned_home(mission),
        )

    def _settles(self, specs: Specs, selection: Selection, objects: FlightObjects) -> Settling:
        config, offloading, watch = self._config, self._offloading, self._watch
        acts = Acts[AnswerAction[Any]](
            self._plan,
            leaving=[via.position for via in self._legs.site.leaving],
            ground_speed_m_s=config.mission.ground_speed_m_s,
            pace=watch.pace,
            photo_s=config.camera.photo_s,
            home_s=watch.home_s if ending(config.mission) == "return" else None,
        )
        about: dict[str, Any] = {
            "legs": self._legs,
            "thread": self._thread,
            "late": LateActs(
                self._legs,
                acts,
                when_to_act=lambda act: offloading.ask(lambda: selection.policy.when_to_act(act)),
                within_s=config.policy.acts_within_s,
                home_s=watch.home_s,
                spare_s=watch.spare_s,
            ),
            "rule": StayRule(config.policy.stay_or_go, self.demand_map),
            "objects": objects,
            "outlook": lambda: offloading.ask(lambda: offloading.planning.outlook()),  # noqa: PLW0108 - located in `ask`
        }
        if not offloading.several:
            return Stops(**about)
        seeking = Seeking(config, selection, offloading, self._legs, watch)
        asks_servers = not all(spec.on_drone for spec in specs.values())
        return Rows(**about, config=config, asks_servers=asks_servers, seeking=seeking)

    def _planned(self) -> schema.Planned:
        home, coverage = self._config.mission.home, self.coverage
        order = [waypoint.index for waypoint in self._order.waypoints]
        places = {waypoint.index: waypoint.position for waypoint in self._order.waypoints}
        areas = server_areas(self._config)
        return schema.Planned(
            home=home.place if home else None,
            waypoints_m=[(places[index].east_m, places[index].north_m) for index in sorted(order)],
            altitudes_m=[places[index].altitude_m for index in sorted(order)],
            order=order if self._order.why else [],
            order_why=self._order.why,
            ranges={name: area for name, area in areas.items() if isinstance(area, Circle)},
            measured={
                server: [schema.MeasuredRecord.of(place) for place in coverage.places(server)]
                for server in coverage.servers
            }
            if coverage is not None
            else {},
            paced=any(service.local_pace_s for service in self._config.services),
        )

    def position_report(self) -> schema.PositionReport:
        """The drone's position, motion, battery, mode, GPS, and link to a server, as one record for the log."""
        vehicle, (server, round_trip_s) = self._ports.autopilot, self._offloading.link
        here, told = rounded(vehicle.position), vehicle.telemetry
        speed_m_s, heading_deg, percent = told.ground_speed_m_s, told.heading_deg, told.battery_percent
        down_s, wind = self._homecoming.left_s, vehicle.wind
        return schema.PositionReport(
            east_m=here.east_m,
            north_m=here.north_m,
            altitude_m=here.altitude_m,
            ground_speed_m_s=None if speed_m_s is None else round(speed_m_s, 2),
            heading_deg=None if heading_deg is None else round(heading_deg, 1),
            battery_percent=None if percent is None else round(percent, 1),
            battery=told.lowest_battery,
            down_s=None if down_s is None else round(down_s, 1),
            server=server,
            round_trip_s=None if round_trip_s is None else round(round_trip_s, 4),
            mode=told.mode,
            armed=told.armed,
            gps=told.gps.kind if told.gps else None,
            satellites=told.gps.satellites if told.gps else None,
            wind_east_m_s=None if wind is None else round(wind.east_m_s, 1),
            wind_north_m_s=None if wind is None else round(wind.north_m_s, 1),
        )

    @property
    def spares_disk(self) -> bool:
        """Whether the disk is nearly full, so that only what matters most is written."""
        return self._sparing.spares_disk

    def stop(self, why: str) -> bool:
        """End the mission early, in the configured safe action; or end the following of a lost vehicle.

        Return False if the mission is being ended already: the caller then ends the program at once. A call within a
        second after the reserve ended the mission counts as made before.
        """
        if self._stopped is None or self._follows:
            self._end_mission(MissionStopped(why))
            return True
        return now_s() - self._stopped_s < _AT_ONCE_S

    def _end_mission(self, error: MissionStopped) -> None:
        if self._stopped is None:
            self._stopped, self._stopped_s = error, now_s()
        self._ports.journal.record(schema.Stopping(why=str(error)))
        self._thread.stop(str(error))
        self._stop_following.set()

    def _hear_vehicle(self, news: VehicleNews) -> None:
        if isinstance(news, Control):
            self._ports.journal.record(schema.ControlChanged(owner=news.owner, why=news.why))
            if not news.is_ours:
                self._thread.stop(str(news))
            return
        self._ports.journal.record(news)
        if isinstance(news, schema.VehicleSaid):
            self._last_words.append((now_s(), news))

    async def _take_vehicle(self) -> None:
        """Claim the vehicle; refuse to begin a mission in the air, but resume one there."""
        autopilot = self._ports.autopilot
        flies = await autopilot.in_the_air()
        if flies and self._done is None:
            raise AutopilotRefused(
                "start",
                "the vehicle is in the air: land it first, or take up the flight that was broken off with "
                "--resume and its event log; nothing was sent",
            )
        await autopilot.claim(resumes=self._done is not None, ordered=self._ordered)
        if flies:
            self._legs.take_up()
        await self._set_dead_man(flies=flies)

    async def _set_dead_man(self, *, flies: bool) -> None:
        """Have the vehicle act by itself once this program is silent; a failure ends a flight that has not begun."""
        settings, journal = self._config.autopilot, self._ports.journal
        if settings.dead_man_s is None or settings.on_failure == "hold":  # no file has both
            return
        try:
            await self._ports.autopilot.dead_man.watch(
                silence_s=settings.dead_man_s, action=settings.on_failure
            )
            journal.record(schema.DeadManSet(silence_s=settings.dead_man_s, action=settings.on_failure))
        except AutopilotOverruled:
            raise
        except AutopilotError as error:
            if not flies:
                raise
            journal.record(schema.DeadManFailed(why=str(error)))

    @contextlib.asynccontextmanager
    async def _ending_safely(self) -> AsyncIterator[None]:
        try:
            yield
        except (Exception, asyncio.CancelledError) as error:
            await self._end(_why(error))
            if isinstance(error, AutopilotOverruled):
                self._require_control()  # later evidence may name another owner
            raise

    async def _fly(self) -> None:
        watch = start(self._watch_battery(), name="the watch of the reserve", failed=self._end_unwatched)
        sparing = start(self._sparing.watch(), name="the watch of supplies", failed=only_logged)
        try:
            async with self._ending_safely():
                await self._run_mission()
            if not await self._stands_disarmed():
                where = "in the air" if self._legs.in_the_air else "with running motors"
                await self._end(f"the mission ended {where}")
        finally:
            await end(watch, sparing)

    async def _stands_disarmed(self) -> bool:
        """Disarm a vehicle that the mission left armed on the ground; return whether it stands disarmed."""
        autopilot = self._ports.autopilot
        if self._legs.in_the_air or not (autopilot.stands and autopilot.control.is_ours):
            return False
        if autopilot.armed:
            try:
                await autopilot.disarm()
            except AutopilotError:
                return False
            self._ports.journal.record(schema.Disarmed())
        return True

    async def _run_mission(self) -> None:
        try:
            await self._thread.run(self._fly_program)
        except UpwashError as error:
            self._require_control()
            if isinstance(error, MissionStopped) and self._stopped is not None:
                raise self._stopped from error
            raise
        except Exception as error:
            raise mission_failed(error) from error
        finally:
            await self._legs.end()
            await self._calls.close()
        self._require_control()
        if self._stopped is not None:  # though the mission made nothing of it
            raise self._stopped

    def _fly_program(self) -> None:
        drone = self._drone()
        if self._plan or self._done is None:
            self._mission(drone)
        elif self._legs.in_the_air:
            drone.end_flight()
            drone.autopilot.disarm()
        self._settling.settle()

    def _require_control(self) -> None:
        """Raise AutopilotOverruled if the program has lost the vehicle, in place of any other error."""
        control = self._ports.autopilot.control
        if not control.is_ours:
            since_s = control.since_s - _WORDS_BEFORE_S
            words = [text.text for said_s, text in self._last_words if said_s >= since_s]
            raise AutopilotOverruled("mission", str(control), "; ".join(dict.fromkeys(words)))

    async def _end(self, why: str) -> None:
        autopilot, journal = self._ports.autopilot, self._ports.journal
        if autopilot.control.is_ours and (self._legs.in_the_air or autopilot.armed):
            self._stop_following.clear()
            self._ends_safely = True
            action = self._config.autopilot.on_failure
            await end_safely(autopilot, action, journal, why=why, homecoming=self._homecoming)
        if not autopilot.control.is_ours:
            self._follows = True
            await follow(autopilot, journal, until=self._stop_following)

    async def _watch_battery(self) -> None:
        while True:
            self._end_at_reserve(await self._watch.reached())
            await asyncio.sleep(_LOOKS_AGAIN_S)

    def _end_unwatched(self, defect: Exception) -> None:
        why = f"a defect has ended the watch of the reserve: {worded(defect)}"
        trace = "".join(traceback.format_exception(defect))
        self._ports.journal.record(schema.BatteryWatchFailed(why=why, trace=trace))
        if self._homecoming.doing is None:
            self._end_at_reserve(why)

    def _end_at_reserve(self, why: str) -> None:
        """End a mission in flight; a vehicle that comes down already is only hurried."""
        if self._homecoming.doing is not None:
            self._homecoming.hurry(why)
        elif self._stopped is None and not self._ends_safely:
            self._end_mission(ReserveReached(why))

    def _drone(self) -> Drone:
        ports, thread, journal = self._ports, self._thread, self._ports.journal
        payload = Payload(ports.autopilot, thread, journal)
        camera = Photographer(
            ports.camera,
            thread,
            journal,
            autopilot=ports.autopilot,
            payload=payload,
            ground=ports.ground,
            album=ports.album,
            photos=self._photos,
            objects=self._settling.objects,
        )
        return Drone(
            self._config,
            plan=self._plan,
            autopilot=Vehicle(self._settling, self._homecoming),
            camera=camera,
            payload=payload,
            user=User(ports.notifier, thread, self._photos),
            calls=self._calls,
            settling=self._settling,
        )


def _why(error: BaseException) -> str:
    if isinstance(error, asyncio.CancelledError):
        return "the program was stopped at once"
    return message_of(error) or type(error).__name__
