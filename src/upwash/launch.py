"""Puts the programs on things: the only place that does."""

from __future__ import annotations

import asyncio
import contextlib
import tempfile
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from upwash.bundled import LoadedService, load_mission, load_services
from upwash.config import (
    CameraConfig,
    DroneConfig,
    ServerConfig,
    is_address,
    is_on_this_machine,
    server_area,
    server_truth,
    unsigned_port,
)
from upwash.core.geo import GeoPosition, LocalFrame
from upwash.drone import Flight, World, rounded
from upwash.errors import CredentialsError, Unreachable, UsageError
from upwash.loading import extra
from upwash.mavlink_signing import Signing
from upwash.ports import Autopilot, Camera, InstanceSpec, Journal, Network
from upwash.profiling import OnboardProfile, Sample, ServerProfile, Watch, profile_onboard, profile_server
from upwash.protocol import STATUS, StatusReply, StatusRequest, decode_reply
from upwash.real.camera import FolderCamera
from upwash.real.clock import SYSTEM_CLOCK, Clock, agree_on_time, keep_right_from_services, problem_by
from upwash.real.credentials import Credentials, read_credentials
from upwash.real.journal import FileJournal, JournalNotifier, Watcher, read_events
from upwash.real.link import GrpcDialer
from upwash.real.log_file import Unwritten
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot, Patience, connect_autopilot
from upwash.real.mavlink.signing import read_key, read_signing
from upwash.real.memory import peak_memory_bytes
from upwash.real.runtime import ProcessRuntime, sockets_in
from upwash.real.signals import outliving_the_terminal, stopping_politely
from upwash.real.video import VideoCamera
from upwash.resumption import waypoints_done
from upwash.service import spec_of
from upwash.sim.camera import RenderedCamera
from upwash.sim.network import Cell, ModelNetwork, NoNetwork
from upwash.visit import Contact

if TYPE_CHECKING:
    from upwash.real.survey import Finding
    from upwash.vehicle.copter import VehicleSettings
    from upwash.vehicle.px4.vehicle import Px4Settings

_MAX_MESSAGE_BYTES = 16 * 2**20
_TRACK_PERIOD_S = 1.0
_STATUS_S = 10.0
_GPS_FIX_S = 60.0  # an autopilot that was just switched on needs about so long
_GPS_REPORT_S = 2.0  # until it was asked for, and has told
_LOOK_S = 0.1
_PROFILER = "profiler"


@dataclass(frozen=True, slots=True)
class VehicleSurvey:
    """What a vehicle runs, and what its dead man lacks, empty where it is ready."""

    firmware: str
    dead_man_lacks: str


# --- a drone ------------------------------------------------------------------------------------------------


async def fly(
    config: DroneConfig,
    *,
    program: str | None = None,
    log: Path,
    resumes: bool = False,
    watchers: tuple[Watcher, ...] = (),
    unwritten: Unwritten | None = None,
    clock: Clock = SYSTEM_CLOCK,
) -> None:
    """Flies the configured mission with the configured vehicle, or another program with it.

    The event log goes to `log`, and each event to the watchers too; what the log lacks at the end is in `unwritten`.
    With `resumes` it takes up the mission that this log is of, where that was broken off. Ctrl-C ends the mission, as
    any failure does: in what autopilot.on_failure says; a second one ends the program at once. Raises what ended the
    mission early.
    """
    home, connection = _home(config), _connection(config)
    mission = load_mission(program or config.mission.program, mode=config.mission.mode)
    services = load_services(config.services)
    done = waypoints_done(read_events(log), config) if resumes else None
    _require_reachable(config)
    signing = _signing(config)
    credentials = drone_credentials(config, valid_now=False)  # before the clock is known to be right
    async with contextlib.AsyncExitStack() as stack:
        watchers += await _metrics(config, stack)
        camera = await _camera(config.camera, stack)
        journal = stack.enter_context(
            contextlib.closing(FileJournal(log, watchers=watchers, resumes=resumes, unwritten=unwritten))
        )
        if problem := unsigned_port(config.autopilot):
            journal.record("unsigned_port", why=problem)
        autopilot = await connect_autopilot(
            connection,
            frame=LocalFrame(home),
            ground_speed_m_s=config.mission.ground_speed_m_s,
            settings=FlightSettings(
                arrival_distance_m=config.autopilot.arrival_distance_m,
                arrival_speed_m_s=config.autopilot.arrival_speed_m_s,
                patience=Patience(lost_after_s=config.autopilot.link_patience_s),
            ),
            signing=signing,
        )
        stack.push_async_callback(autopilot.close)
        if credentials is not None:
            gps_unix_s = await _gps_unix_s(autopilot, problem_by(clock, credentials), journal)
            agree_on_time(gps_unix_s, credentials, journal, clock=clock)
        keep_right_from_services()
        sockets = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="upwash-")))
        flight = Flight(
            mission,
            config,
            services={name: service.cls for name, service in services.items()},
            world=World(
                autopilot=autopilot,
                networks=await _networks(config, autopilot, journal, stack),
                dialer=_dialer(config, credentials),
                onboard_dialer=_onboard_dialer(config.name),
                onboard_runtime=_onboard_runtime(sockets),
                camera=camera,
                notifier=JournalNotifier(journal),
                journal=journal,
            ),
            programs={name: service.program for name, service in services.items()},
            done=done,
        )
        await stack.enter_async_context(_tracking(autopilot, journal))
        stack.enter_context(stopping_politely(flight.stop))
        stack.enter_context(outliving_the_terminal())
        await flight.run()


def _home(config: DroneConfig) -> GeoPosition:
    home = config.mission.home
    if home is None:
        raise UsageError(
            "mission.home is missing: a flight needs the place where east and north are 0, such as "
            "home = { latitude_deg = 39.3666, longitude_deg = 22.9507 } in [mission]"
        )
    return GeoPosition(home.latitude_deg, home.longitude_deg)


def _connection(config: DroneConfig) -> str:
    if config.autopilot.connection is None:
        raise UsageError(
            "autopilot.connection is missing: say how the vehicle is reached, or use --autopilot"
        )
    return config.autopilot.connection


def _signing(config: DroneConfig) -> Signing | None:
    key = config.autopilot.signing_key
    return read_signing(key) if key else None


async def _metrics(config: DroneConfig, stack: contextlib.AsyncExitStack) -> tuple[Watcher, ...]:
    """What keeps the metrics up to date, where they are asked for; they are offered from now on."""
    if config.metrics is None:
        return ()
    with extra("metrics"):
        from upwash.metrics.drone import DroneMetrics
        from upwash.metrics.exposition import exposed
    metrics = DroneMetrics([server.name for server in config.servers])
    await stack.enter_async_context(exposed(metrics.registry, config.metrics))
    return (metrics.follow,)


async def _camera(config: CameraConfig, stack: contextlib.AsyncExitStack) -> Camera:
    if config.folder is not None:
        return FolderCamera(config.folder, photo_s=config.photo_s)
    if config.park_seed is not None:
        return RenderedCamera(config.park_seed, photo_s=config.photo_s, in_thread=True)
    if config.device is not None:
        return stack.enter_context(contextlib.closing(await VideoCamera.open(config.device)))
    raise UsageError(
        "no camera: say in [camera] where photos come from: folder, device, or park_seed for rendered ones"
    )


def _onboard_runtime(sockets: Path) -> ProcessRuntime:
    return ProcessRuntime(sockets_in(sockets), max_message_bytes=_MAX_MESSAGE_BYTES)


def _onboard_dialer(drone: str) -> GrpcDialer:
    return GrpcDialer(drone, None, max_message_bytes=_MAX_MESSAGE_BYTES)


def _require_reachable(config: DroneConfig) -> None:
    """Refuses servers whose address is not known, or that are not to be called without certificates."""
    for server in config.servers:
        if not server.address:
            raise UsageError(
                f"server {server.name} has no address: a flight needs to know where its daemon is"
            )
        if config.keys is None and not is_on_this_machine(server.address):
            raise UsageError(
                f"server {server.name} at {server.address} needs certificates: make them with `upwash keys` "
                "and name them in [keys]; only servers on this machine are called without"
            )


def _dialer(config: DroneConfig, credentials: Credentials | None) -> GrpcDialer:
    return GrpcDialer(config.name, credentials, max_message_bytes=_MAX_MESSAGE_BYTES)


def drone_credentials(config: DroneConfig, *, valid_now: bool = True) -> Credentials | None:
    """What the drone shows servers, None without [keys]; raises CredentialsError where that is not the drone's.

    With `valid_now` it is valid by this computer's clock.
    """
    keys = config.keys
    if keys is None:
        return None
    credentials = read_credentials(keys.authority, keys.certificate, keys.key, valid_now=valid_now)
    if config.name not in credentials.names:
        raise CredentialsError(
            f"the certificate is for {', '.join(credentials.names)}, but this drone is called {config.name}: "
            f'write name = "{credentials.names[0]}" at the top of its configuration, or make another certificate'
        )
    return credentials


async def _gps_unix_s(autopilot: MavlinkAutopilot, problem: str, journal: Journal) -> float | None:
    """The time by the vehicle's GPS; where certificates are not valid by this computer's, its fix is waited for."""
    if problem and autopilot.unix_s is None:
        journal.record("waiting_for_the_time", why=problem)
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(_GPS_FIX_S if problem else _GPS_REPORT_S):
            while autopilot.unix_s is None:  # noqa: ASYNC110 - it comes by a message a second
                await asyncio.sleep(_LOOK_S)
    return autopilot.unix_s


async def _networks(
    config: DroneConfig, autopilot: Autopilot, journal: Journal, stack: contextlib.AsyncExitStack
) -> list[Network]:
    radios = range(config.network.radios)
    if config.network.kind == "wired":
        return [NoNetwork() for _ in radios]
    if config.network.kind == "networkmanager":
        return [
            await _managed_network(interfaces, config, journal, stack) for interfaces in _per_radio(config)
        ]
    cells: dict[str, list[Cell]] = {}
    for server in config.servers:
        area = server_area(server, config.mission.home)
        join_s = server_truth(server, config.services).join_s
        cells.setdefault(server.network, []).append(Cell(area, join_s))
    return [ModelNetwork(cells, lambda: autopilot.position) for _ in radios]


def _per_radio(config: DroneConfig) -> list[tuple[str, ...]]:
    """The interfaces of each radio: a single one joins networks on whichever fits, of several each has its own."""
    interfaces = config.network.interfaces
    return [interfaces] if config.network.radios == 1 else [(each,) for each in interfaces]


async def _managed_network(
    interfaces: Sequence[str], config: DroneConfig, journal: Journal, stack: contextlib.AsyncExitStack
) -> Network:
    with extra("network"):
        from upwash.real.network import ManagedNetwork
    network = ManagedNetwork(interfaces, [server.network for server in config.servers], journal)
    stack.push_async_callback(network.close)
    await network.open()
    return network


async def survey_networks(config: DroneConfig) -> list[Finding]:
    """What NetworkManager has ready for the drone; raises NetworkError without one."""
    with extra("network"):
        from upwash.real.survey import survey_networks
    return await survey_networks(
        config.network.interfaces,
        {server.name: server.network for server in config.servers},
        radios=config.network.radios,
    )


async def survey_vehicle(config: DroneConfig, *, install_dead_man: bool) -> VehicleSurvey:
    """What the configured vehicle says of itself; with `install_dead_man` it is given its dead man first."""
    autopilot = await connect_autopilot(
        _connection(config),
        frame=LocalFrame(_home(config)),
        ground_speed_m_s=config.mission.ground_speed_m_s,
        signing=_signing(config),
    )
    try:
        left_to_do = ""
        if install_dead_man:
            await autopilot.claim(resumes=False)
            left_to_do = await autopilot.dead_man.install()
        return VehicleSurvey(autopilot.firmware, left_to_do or await autopilot.dead_man.missing())
    finally:
        await autopilot.close()


@contextlib.asynccontextmanager
async def _tracking(autopilot: Autopilot, journal: Journal) -> AsyncIterator[None]:
    """Logs where the drone is, every second."""

    async def track() -> None:
        while True:
            journal.record("position", **rounded(autopilot.position))
            await asyncio.sleep(_TRACK_PERIOD_S)

    task = asyncio.create_task(track())
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


# --- a service, before the flight ---------------------------------------------------------------------------


async def profile_on_this_computer(
    service: LoadedService, found: Sequence[Sample], *, calls: int, watch: Watch
) -> OnboardProfile:
    """Measures the service in instances such as the drone's own."""
    with tempfile.TemporaryDirectory(prefix="upwash-") as sockets:
        return await profile_onboard(
            InstanceSpec(_PROFILER, spec_of(service.cls).name, service.program),
            found,
            calls=calls,
            drone=_PROFILER,
            runtime=_onboard_runtime(Path(sockets)),
            dialer=_onboard_dialer(_PROFILER),
            memory_bytes=peak_memory_bytes,
            watch=watch,
        )


async def profile_at(
    server: ServerConfig, config: DroneConfig, found: Sequence[Sample], *, calls: int, watch: Watch
) -> ServerProfile:
    """Measures a service at one of the drone's servers, with the drone's certificate."""
    config = msgspec.structs.replace(config, servers=(server,))
    _require_reachable(config)
    dialer = _dialer(config, drone_credentials(config))
    services = tuple(dict.fromkeys(sample.operation.service for sample in found))
    contact = Contact(server.name, server.network, server.address or "", services)
    return await profile_server(contact, found, calls=calls, network=NoNetwork(), dialer=dialer, watch=watch)


# --- an operator ---------------------------------------------------------------------------------------------


async def ask_status(address: str, *, server: str, operator: str, keys: Path | None) -> StatusReply:
    """How the daemon at the address is; `server` is one that it acts as. Raises LinkError where it does not say."""
    if not is_address(address):
        raise UsageError(f'"{address}" is no address: give host:port, or unix:path')
    if keys is None and not is_on_this_machine(address):
        raise UsageError(f"{address} is another machine: give --keys DIR, --operator NAME and --server NAME")
    if keys is not None and not server:
        raise UsageError("--server is missing: name a server that the daemon's certificate is for")
    credentials = keys and read_credentials(
        keys / "authority.pem", keys / f"{operator}.pem", keys / f"{operator}.key"
    )
    dialer = GrpcDialer(operator, credentials or None, max_message_bytes=_MAX_MESSAGE_BYTES)
    link = dialer.dial(address, server=server or "daemon")
    try:
        reply = await link.request(STATUS, msgspec.msgpack.encode(StatusRequest()), timeout_s=_STATUS_S)
    except Unreachable as error:
        remedy = (
            "" if keys else "; a daemon that has certificates wants yours: give --keys DIR and --server NAME"
        )
        raise Unreachable(f"{error}{remedy}") from error
    finally:
        await link.close()
    return decode_reply(reply, StatusReply, sender=address)


# --- a stand-in vehicle -------------------------------------------------------------------------------------


async def run_vehicle(
    listen: str,
    settings: VehicleSettings | Px4Settings,
    *,
    ready: Callable[[str], None],
    signing_key: Path | None = None,
) -> None:
    """Runs a stand-in vehicle until SIGTERM or Ctrl-C; `ready` is told the address once it answers."""
    from upwash.vehicle.server import serve_vehicle  # with its firmwares 2.6 MB, which a drone need not hold

    signing = Signing(read_key(signing_key)) if signing_key else None
    vehicle = await serve_vehicle(listen, settings, signing=signing)
    stopped = asyncio.Event()
    with stopping_politely(lambda _: stopped.set()):
        try:
            ready(vehicle.address)
            await stopped.wait()
        finally:
            await vehicle.close()
