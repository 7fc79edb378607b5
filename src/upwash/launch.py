"""Puts the programs on things: the only place that does."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import signal
import tempfile
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from pathlib import Path

import msgspec

from upwash.bundled import LoadedService, load_mission, load_services
from upwash.config import (
    CameraConfig,
    DaemonConfig,
    DroneConfig,
    KeysConfig,
    ServerConfig,
    is_on_this_machine,
    server_area,
    server_truth,
)
from upwash.core.geo import GeoPosition, LocalFrame
from upwash.core.instances import Host, HostSettings, ServerOffer
from upwash.drone import Flight, World
from upwash.errors import CredentialsError, Refused, UsageError
from upwash.ports import Autopilot, Camera, InstanceSpec, Journal, Network, Program, Runtime
from upwash.profiling import OnboardProfile, Sample, ServerProfile, Watch, profile_onboard, profile_server
from upwash.real.autopilot import FlightSettings, connect_autopilot
from upwash.real.camera import FolderCamera
from upwash.real.credentials import Credentials, read_credentials
from upwash.real.journal import FileJournal, JournalNotifier, Watcher, read_events
from upwash.real.link import GrpcDialer
from upwash.real.listener import Caller, Listener
from upwash.real.memory import peak_memory_bytes
from upwash.real.runtime import ProcessRuntime
from upwash.real.video import VideoCamera
from upwash.resumption import waypoints_done
from upwash.server import EdgeServer, Image
from upwash.service import spec_of
from upwash.sim.camera import RenderedCamera
from upwash.sim.network import Cell, ModelNetwork, NoNetwork
from upwash.vehicle import VehicleSettings, serve_vehicle
from upwash.visit import Contact

_MAX_MESSAGE_BYTES = 16 * 2**20
_TRACK_PERIOD_S = 1.0
_SECOND_SIGNAL_S = 0.5  # a terminal and a parent may both pass on one Ctrl-C
_DAEMON_THREADS = 16
_PROFILER = "profiler"


# --- a drone ------------------------------------------------------------------------------------------------


async def fly(
    config: DroneConfig,
    *,
    program: str | None = None,
    log: Path,
    resumes: bool = False,
    watchers: tuple[Watcher, ...] = (),
) -> None:
    """Flies the configured mission with the configured vehicle, or another program with it.

    The event log goes to `log`, and each event to the watchers too; with `resumes` it takes up the mission that this
    log is of, where that was broken off. Ctrl-C ends the mission, as any failure does:
    in what autopilot.on_failure says; a second one ends the program at once. Raises what ended the mission early.
    """
    if config.mission.home is None:
        raise UsageError(
            "mission.home is missing: a flight needs the place where east and north are 0, such as "
            "home = { latitude_deg = 39.3666, longitude_deg = 22.9507 } in [mission]"
        )
    if config.autopilot.connection is None:
        raise UsageError(
            "autopilot.connection is missing: say how the vehicle is reached, or use --autopilot"
        )
    mission = load_mission(program or config.mission.program, mode=config.mission.mode)
    services = load_services(config.services)
    done = waypoints_done(read_events(log), config) if resumes else None
    dialer = _dialer(config)
    home = GeoPosition(config.mission.home.latitude_deg, config.mission.home.longitude_deg)
    async with contextlib.AsyncExitStack() as stack:
        camera = await _camera(config.camera, stack)
        journal = stack.enter_context(
            contextlib.closing(FileJournal(log, watchers=watchers, resumes=resumes))
        )
        autopilot = await connect_autopilot(
            config.autopilot.connection,
            frame=LocalFrame(home),
            ground_speed_m_s=config.mission.ground_speed_m_s,
            settings=FlightSettings(
                arrival_distance_m=config.autopilot.arrival_distance_m,
                arrival_speed_m_s=config.autopilot.arrival_speed_m_s,
            ),
        )
        stack.push_async_callback(autopilot.close)
        sockets = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="upwash-")))
        flight = Flight(
            mission,
            config,
            services={name: service.cls for name, service in services.items()},
            world=World(
                autopilot=autopilot,
                network=_network(config, autopilot),
                dialer=dialer,
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
        stack.enter_context(_stopping_politely(flight.stop))
        await flight.run()


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
    return ProcessRuntime(_sockets_in(sockets), credentials=None, max_message_bytes=_MAX_MESSAGE_BYTES)


def _onboard_dialer(drone: str) -> GrpcDialer:
    return GrpcDialer(drone, None, max_message_bytes=_MAX_MESSAGE_BYTES)


def _dialer(config: DroneConfig) -> GrpcDialer:
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
    credentials = _credentials(config.keys)
    if credentials is not None and config.name not in credentials.names:
        raise CredentialsError(
            f"the certificate is for {', '.join(credentials.names)}, but this drone is called {config.name}: "
            f'write name = "{credentials.names[0]}" at the top of its configuration, or make another certificate'
        )
    return GrpcDialer(config.name, credentials, max_message_bytes=_MAX_MESSAGE_BYTES)


def _credentials(keys: KeysConfig | None) -> Credentials | None:
    return read_credentials(keys.authority, keys.certificate, keys.key) if keys else None


def _network(config: DroneConfig, autopilot: Autopilot) -> Network:
    if config.network.kind == "wired":
        return NoNetwork()
    cells: dict[str, list[Cell]] = {}
    for server in config.servers:
        area = server_area(server, config.mission.home)
        join_s = server_truth(server, config.services).join_s
        cells.setdefault(server.network, []).append(Cell(area, join_s))
    return ModelNetwork(cells, lambda: autopilot.position)


@contextlib.asynccontextmanager
async def _tracking(autopilot: Autopilot, journal: Journal) -> AsyncIterator[None]:
    """Logs where the drone is, every second."""

    async def track() -> None:
        while True:
            position = autopilot.position
            journal.record(
                "position",
                east_m=round(position.east_m, 2),
                north_m=round(position.north_m, 2),
                altitude_m=round(position.altitude_m, 2),
            )
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
    dialer = _dialer(msgspec.structs.replace(config, servers=(server,)))
    services = tuple(dict.fromkeys(sample.operation.service for sample in found))
    contact = Contact(server.name, server.network, server.address or "", services)
    return await profile_server(contact, found, calls=calls, network=NoNetwork(), dialer=dialer, watch=watch)


# --- an edge server -----------------------------------------------------------------------------------------


async def serve(config: DaemonConfig, *, ready: Callable[[str], None]) -> None:
    """Runs the daemon until SIGTERM or Ctrl-C; `ready` is told the address once it answers."""
    from grpc_health.v1 import health, health_pb2, health_pb2_grpc

    images = _images(config)
    credentials = _server_credentials(config)
    loop = asyncio.get_running_loop()
    async with contextlib.AsyncExitStack() as stack:
        sockets = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="upwash-")))
        edge = EdgeServer(
            Host(
                {each.name: ServerOffer(frozenset(each.images), each.slots) for each in config.identities},
                HostSettings(lease_s=config.lease_s, idle_stop_s=config.idle_stop_s),
            ),
            images=images,
            runtime=await stack.enter_async_context(_runtime(config, credentials, sockets)),
            start_timeout_s=config.start_timeout_s,
        )

        def handle(path: str, body: bytes, caller: Caller) -> bytes:
            answer = asyncio.run_coroutine_threadsafe(edge.handle(path, body, caller.drone), loop)
            try:
                return answer.result(timeout=caller.time_left_s())
            except TimeoutError:
                answer.cancel()
                raise Refused("the drone's deadline is over") from None

        listener = Listener(
            config.listen,
            handle,
            credentials=credentials,
            max_message_bytes=config.max_message_bytes,
            threads=_DAEMON_THREADS,
            concurrent_requests=_DAEMON_THREADS,
        )
        status = health.HealthServicer()
        health_pb2_grpc.add_HealthServicer_to_server(status, listener.grpc_server)
        for name in ("", *(each.name for each in config.identities)):
            status.set(name, health_pb2.HealthCheckResponse.SERVING)
        stopped = asyncio.Event()
        stack.enter_context(_stopping_politely(lambda _: stopped.set()))
        listener.start()
        stack.push_async_callback(edge.close)
        stack.push_async_callback(asyncio.to_thread, listener.stop)
        ready(listener.address)
        watch = asyncio.create_task(edge.run())
        stack.callback(watch.cancel)
        await stopped.wait()
        status.enter_graceful_shutdown()


def _images(config: DaemonConfig) -> dict[str, Image]:
    """What each service is; in a container its program is the image's, and checks its settings there."""
    if config.runtime.kind == "lxd":
        programs = {
            each.name: Program("", each.settings.values if each.settings else {}) for each in config.images
        }
    else:
        programs = {name: service.program for name, service in load_services(config.images).items()}
    return {each.name: Image(programs[each.name], each.pace_s, each.start_pace_s) for each in config.images}


@contextlib.asynccontextmanager
async def _runtime(
    config: DaemonConfig, credentials: Credentials | None, sockets: Path
) -> AsyncIterator[Runtime]:
    if config.runtime.kind == "lxd":
        from upwash.hosting import container_runtime

        assert credentials is not None  # noqa: S101 - the configuration was checked for that
        async with container_runtime(config, credentials) as containers:
            yield containers
    else:
        yield ProcessRuntime(
            _beside(config.listen, sockets),
            credentials=credentials,
            max_message_bytes=config.max_message_bytes,
        )


def _server_credentials(config: DaemonConfig) -> Credentials | None:
    credentials = _credentials(config.keys)
    if credentials is not None:
        for identity in config.identities:
            if identity.name not in credentials.names:
                raise CredentialsError(
                    f"the certificate is for {', '.join(credentials.names)}, but this daemon acts as "
                    f"{identity.name}: make one with `upwash keys DIR --server "
                    f"{','.join(each.name for each in config.identities)}`"
                )
    return None if config.listen.startswith("unix:") else credentials


def _beside(listen: str, sockets: Path) -> Callable[[InstanceSpec], str]:
    """Instances listen on the daemon's own interface, on ports of the system's choice."""
    if listen.startswith("unix:"):
        return _sockets_in(sockets)
    host = listen.rpartition(":")[0]
    return lambda _: f"{host}:0"


def _sockets_in(folder: Path) -> Callable[[InstanceSpec], str]:
    numbers = itertools.count()
    return lambda spec: f"unix:{folder}/{spec.name}-{next(numbers)}.sock"


# --- a stand-in vehicle -------------------------------------------------------------------------------------


async def run_vehicle(listen: str, settings: VehicleSettings, *, ready: Callable[[str], None]) -> None:
    """Runs a stand-in vehicle until SIGTERM or Ctrl-C; `ready` is told the address once it answers."""
    vehicle = await serve_vehicle(listen, settings)
    stopped = asyncio.Event()
    with _stopping_politely(lambda _: stopped.set()):
        try:
            ready(vehicle.address)
            await stopped.wait()
        finally:
            await vehicle.close()


@contextlib.contextmanager
def _stopping_politely(stop: Callable[[str], None]) -> Iterator[None]:
    """The first SIGINT or SIGTERM asks to stop; the second cancels what runs."""
    loop = asyncio.get_running_loop()
    running = asyncio.current_task()
    asked_s: list[float] = []

    def on_signal(number: signal.Signals) -> None:
        now_s = loop.time()
        if not asked_s:
            stop("Ctrl-C" if number is signal.SIGINT else number.name)
        elif now_s - asked_s[0] > _SECOND_SIGNAL_S and running is not None:
            running.cancel()
        asked_s.append(now_s)

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, on_signal, number)
    try:
        yield
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)
