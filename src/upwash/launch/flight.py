"""Puts a drone's flight on things: its vehicle, camera, networks, servers and services."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from msgspec.structs import replace

from upwash.config.drone import DroneConfig, unsigned_port
from upwash.config.places import altitudes_above_sea, coverage_kept, demands_kept
from upwash.config.user import UserConfig
from upwash.core.camera.georeference import Ground, level_ground
from upwash.core.geo import Position
from upwash.drone.flight import Flight, Ports
from upwash.drone.home import above_home
from upwash.drone.objects import FlightObjects
from upwash.drone.resumption import objects_acted_on, order_begun, ordered_down, waypoints_done
from upwash.errors import AutopilotError, NotWritten
from upwash.eventlog import schema
from upwash.launch.cameras import NoCamera, followers_of, needs_camera, opened_album, opened_camera
from upwash.launch.drone import (
    connect_vehicle,
    drone_credentials,
    home_of,
    opened_networks,
    server_dialer,
    server_finder,
)
from upwash.launch.readiness import require_ready
from upwash.launch.watchdog import watched
from upwash.missions.bundled import load_services
from upwash.missions.program import load_mission
from upwash.ports import Autopilot, Camera, ComingDown, Journal
from upwash.real.camera.terrain import Terrain
from upwash.real.host.clock import (
    SYSTEM_CLOCK,
    SystemClock,
    agree_on_time,
    keep_right_from_services,
    problem_by,
)
from upwash.real.host.computer import HostComputer, with_many_files
from upwash.real.host.journal import FileJournal, Unwritten, Watcher, read_events
from upwash.real.host.signals import outliving_the_terminal, stopping_politely
from upwash.real.instances.runtime import OwnProcesses
from upwash.real.mavlink import DriverPatience, FlightSettings, MavlinkAutopilot
from upwash.real.trust.credentials import Credentials
from upwash.support.background import end, only_logged, start
from upwash.support.loading import extra

if TYPE_CHECKING:
    from upwash.launch.handover import Handover

_TRACK_PERIOD_S, _SPARING_PERIOD_S = 1.0, 10.0
_GPS_FIX_S = 60.0  # about what an autopilot needs after it is switched on
_GPS_REPORT_S = 2.0  # for the request and its reply
_LOOK_S = 0.1


async def fly(
    config: DroneConfig,
    *,
    program: str | None = None,
    log: Path,
    resumes: bool = False,
    watchers: tuple[Watcher, ...] = (),
    unwritten: Unwritten | None = None,
    clock: SystemClock = SYSTEM_CLOCK,
    takes_over: Sequence[str] = (),
    speed_why: str = "",
) -> None:
    """Flies the configured mission with the configured vehicle, or another program with it.

    The event log goes to `log`, and each event to the watchers too; `unwritten` gets events that could not be logged.
    With `resumes` the log's mission goes on from its last waypoint. Without a dead man in the autopilot, the command
    `takes_over` runs after this program has stood still and was killed. Ctrl-C or a failure ends the mission with the
    action of autopilot.on_failure; a second Ctrl-C ends the program at once. Raises what ended the mission early.
    `speed_why` is why its ground speed was chosen, "" if it was given.
    """
    if program is not None:
        config = replace(config, mission=replace(config.mission, program=program))
    require_ready(config)
    with_many_files()
    mission = load_mission(config.mission.program, mode=config.mission.mode)
    services = load_services(config.services)
    earlier = _earlier(log, config) if resumes else _Earlier()
    credentials = drone_credentials(config, valid_now=False)  # before the clock is known to be right
    async with contextlib.AsyncExitStack() as stack:
        watchers += await _metrics(config, stack)
        handover = _handover(config, log if resumes else None)
        watchers += () if handover is None else (handover.follow,)
        camera: Camera = NoCamera()
        if needs_camera(config):
            in_flight = config.mission.photos is not None
            camera = await opened_camera(config.camera, stack, in_flight=in_flight)
            watchers += followers_of(camera)
        journal = stack.enter_context(
            contextlib.closing(FileJournal(log, watchers=watchers, resumes=resumes, unwritten=unwritten))
        )
        if handover is not None:
            await stack.enter_async_context(handover.running(journal.record))
        autopilot = await _autopilot(config, journal, stack)
        if credentials is not None:
            gps_unix_s = await _gps_unix_s(autopilot, problem_by(clock, credentials), journal)
            agree_on_time(gps_unix_s, credentials, journal, clock=clock)
        keep_right_from_services()
        config = await _above_home(config, autopilot, journal)
        flight = Flight(
            mission,
            config,
            services={name: service.cls for name, service in services.items()},
            ports=await _ports(config, autopilot, camera, credentials, journal=journal, stack=stack),
            programs={name: service.program for name, service in services.items()},
            parts={name: service.part for name, service in services.items() if service.part},
            done=earlier.done,
            ordered=earlier.ordered,
            order=order_begun(read_events(log), config) if resumes else None,
            objects=earlier.objects,
            speed_why=speed_why,
        )
        await stack.enter_async_context(_tracking(flight, journal))
        if config.autopilot.dead_man_s is None:
            await stack.enter_async_context(watched(takes_over))
        stack.enter_context(stopping_politely(flight.stop))
        stack.enter_context(outliving_the_terminal())
        try:
            await flight.run()
        finally:
            _keep_maps(config, flight, journal)


class _Earlier(NamedTuple):
    """What an interrupted mission has done; None where no mission is taken up."""

    done: frozenset[int] | None = None
    ordered: ComingDown | None = None
    objects: FlightObjects | None = None


def _earlier(log: Path, config: DroneConfig) -> _Earlier:
    events = read_events(log)
    return _Earlier(waypoints_done(events, config), ordered_down(events), objects_acted_on(events))


def _keep_maps(config: DroneConfig, flight: Flight, journal: Journal) -> None:
    try:
        if flight.coverage is not None:
            coverage_kept(config, flight.coverage)
    except NotWritten as error:
        journal.record(schema.CoverageNotKept(why=str(error)))
    try:
        if flight.demand_map is not None:
            demands_kept(config, flight.demand_map)
    except NotWritten as error:
        journal.record(schema.DemandsNotKept(why=str(error)))


async def _autopilot(
    config: DroneConfig, journal: Journal, stack: contextlib.AsyncExitStack
) -> MavlinkAutopilot:
    if problem := unsigned_port(config.autopilot):
        journal.record(schema.UnsignedPort(why=problem))
    within_s = config.autopilot.found_within_s

    def wait(why: str, waited_s: float) -> None:
        journal.record(schema.WaitingForVehicle(why=why, waited_s=round(waited_s, 1), within_s=within_s))

    autopilot = await connect_vehicle(
        config,
        FlightSettings(
            arrival_distance_m=config.autopilot.arrival_distance_m,
            arrival_speed_m_s=config.autopilot.arrival_speed_m_s,
            patience=DriverPatience(lost_after_s=config.autopilot.link_patience_s),
        ),
        within_s=within_s,
        waiting=wait,
    )
    stack.push_async_callback(autopilot.close)
    found, version = autopilot.vehicle.found_vehicle, autopilot.vehicle.version
    journal.record(
        schema.VehicleFound(
            system=found.system,
            component=found.component,
            firmware=found.firmware,
            type=found.kind,
            version=str(version) if version else None,
        )
    )
    return autopilot


async def _above_home(config: DroneConfig, autopilot: MavlinkAutopilot, journal: Journal) -> DroneConfig:
    """The mission with altitudes above the vehicle's home; altitudes above the sea have to wait for its position."""
    if altitudes_above_sea(config.mission) is None:
        return config

    def tell_delay() -> None:
        reason = "the plan counts altitudes from the sea, and the vehicle does not know its home yet"
        journal.record(schema.ArmingDelayed(reasons=[reason]))

    try:
        return above_home(config, await autopilot.home_above_sea_m(tell_delay))
    except AutopilotError as error:
        journal.record(schema.MissionEnded(why=str(error)))
        raise


async def _ports(
    config: DroneConfig,
    autopilot: Autopilot,
    camera: Camera,
    credentials: Credentials | None,
    *,
    journal: FileJournal,
    stack: contextlib.AsyncExitStack,
) -> Ports:
    own = OwnProcesses(config.name, max_message_bytes=config.max_message_bytes)
    return Ports(
        autopilot=autopilot,
        networks=await opened_networks(config, autopilot, journal, stack),
        dialer=server_dialer(config, credentials),
        onboard_dialer=own,
        onboard_runtime=own,
        camera=camera,
        notifier=journal,
        journal=journal,
        finder=server_finder(config),
        computer=stack.enter_context(contextlib.closing(HostComputer(journal.path.parent))),
        ground=_ground(config, stack),
        album=None
        if config.camera.keep is None
        else opened_album(config.camera.keep, read_events(journal.path)),
    )


def _ground(config: DroneConfig, stack: contextlib.AsyncExitStack) -> Callable[[Position], Ground]:
    """The terrain, until the stack is closed; raises UsageError for a file that is none, or does not reach home."""
    if config.camera.terrain is None:
        return level_ground
    return stack.enter_context(contextlib.closing(Terrain(config.camera.terrain, home_of(config)))).ground


def _handover(config: DroneConfig, earlier: Path | None) -> Handover | None:
    """Hands findings over to the recipients of the configuration; `earlier` is the log of a resumed flight."""
    if config.user == UserConfig():
        return None
    from upwash.launch.handover import Handover
    from upwash.launch.recipients import recipients_of

    events = () if earlier is None else read_events(earlier)
    return Handover(recipients_of(config.user), drone=config.name, home=home_of(config), earlier=events)


async def _metrics(config: DroneConfig, stack: contextlib.AsyncExitStack) -> tuple[Watcher, ...]:
    """The watcher that counts metrics, which are offered from now on; empty without `metrics`."""
    if config.metrics is None:
        return ()
    with extra("metrics"):
        from upwash.metrics.drone import DroneMetrics
        from upwash.metrics.exposition import exposed
    metrics = DroneMetrics([server.name for server in config.servers])
    await stack.enter_async_context(exposed(metrics.registry, config.metrics, config.metrics_hosts))
    return (metrics.follow,)


async def _gps_unix_s(autopilot: MavlinkAutopilot, problem: str, journal: Journal) -> float | None:
    """The time by the vehicle's GPS; its fix is awaited if this computer's clock makes certificates invalid."""
    if problem and autopilot.vehicle.unix_s is None:
        journal.record(schema.WaitingForTheTime(why=problem))
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(_GPS_FIX_S if problem else _GPS_REPORT_S):
            while autopilot.vehicle.unix_s is None:  # noqa: ASYNC110 - it comes by a message a second
                await asyncio.sleep(_LOOK_S)
    return autopilot.vehicle.unix_s


@contextlib.asynccontextmanager
async def _tracking(flight: Flight, journal: Journal) -> AsyncIterator[None]:
    async def track() -> None:
        while not flight.has_ended:
            journal.record(flight.position_report())
            await asyncio.sleep(_SPARING_PERIOD_S if flight.spares_disk else _TRACK_PERIOD_S)

    task = start(track(), name="the log of the drone's positions", failed=only_logged)
    try:
        yield
    finally:
        await end(task)
