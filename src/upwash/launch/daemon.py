"""Starts the edge daemon on this machine's sockets, processes, signals, certificates and service manager."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import logging
import signal
import socket
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from upwash.config.daemon import DaemonConfig
from upwash.core.admission.admission import AdmissionController, AdmissionSettings
from upwash.core.admission.clients import Client
from upwash.errors import DeadlineExceeded, UpwashError, UsageError
from upwash.launch.confinement import Confinement, find_confinement
from upwash.launch.daemon_changes import RunningDaemon, take_up
from upwash.launch.daemon_keys import DaemonKeys, warn_without_list, watch_expiry
from upwash.launch.daemon_reload import ConfigFile, Reloads, note_services, offers
from upwash.launch.daemon_services import DaemonServices, Services
from upwash.launch.in_force import CONFIGURATION, KEYS, REVOCATIONS, InForce
from upwash.ports import Engine, InstanceSpec, Runtime
from upwash.real.host.log import RateLimitedLog
from upwash.real.host.scratch import socket_folder
from upwash.real.host.service_manager import ServiceManager
from upwash.real.host.signals import ending_in_time, on_signal, stopping_politely
from upwash.real.instances.runtime import PlugInRuntime, ProcessRuntime, sockets_in
from upwash.real.link.door import Door, OnTraffic, leading, opened_door
from upwash.real.link.hand_over import HandedOver
from upwash.real.link.limits import DoorLimits
from upwash.real.link.listener import HealthCheck, Listener, cannot_listen
from upwash.real.link.orders import Obeyed, taking_orders
from upwash.real.link.proxy import GrpcSocket
from upwash.real.link.requests import Caller, Requests
from upwash.real.link.streams import listening_socket
from upwash.server.daemon import EdgeServer
from upwash.server.instances import Observer
from upwash.support.background import beside, first, never
from upwash.support.entry_points import INSTANCES, made
from upwash.support.loading import extra
from upwash.support.text import printable

if TYPE_CHECKING:
    from upwash.metrics.daemon import DaemonMetrics

_log = logging.getLogger("upwash.serving")
Handle = Callable[[str, bytes, Client], Coroutine[Any, Any, bytes]]

_CONCURRENT_REQUESTS = 128  # most take no time, a start as long as the service needs
_REQUESTS_PER_DRONE = 8
_LONGEST_REQUEST_BYTES = 2**20  # photos go to instances
_LONGEST_ANSWER_S = 600.0  # without a deadline of the caller
_LAST_ANSWERS_S = 5.0
_METRICS_S = 0.5  # between two attempts to offer metrics at the address of the daemon before
_ENDING_S = 30.0  # for all that follows the calls in progress
for _name in ("upwash.usage", "upwash.requests"):  # drones may come, go and ask often
    logging.getLogger(_name).addFilter(RateLimitedLog())
_M_ARENA_MAX = -8  # from glibc's malloc.h
_CLOSING = "this edge server is shutting down"


async def serve(
    file: Path,
    *,
    ready: Callable[[str, str], None],
    manager: ServiceManager,
    before: HandedOver | None = None,
) -> None:
    """Run the daemon until SIGTERM or Ctrl-C, which leave calls in progress `drain_s`.

    `ready` gets the names of its servers and its address.

    At SIGHUP the `file` of its configuration is read again, once the daemon is ready. At SIGUSR2 the program on the
    disk takes the daemon's place, as this daemon takes the place of the daemon `before`. Raises UsageError for what
    cannot work.
    """
    config_file = ConfigFile(file)
    config, digest = config_file.read()
    _require_discovery(config)
    confinement = await find_confinement(config)
    keys = DaemonKeys(config, revoked=before.revoked() if before else frozenset())
    loop = asyncio.get_running_loop()

    def on_traffic(server: str, drone: str) -> None:  # in the door's own thread
        loop.call_soon_threadsafe(edge.seen, server, drone)

    async with contextlib.AsyncExitStack() as stack:
        asked_to_go, stopped, hung_up = _signals(stack)
        started = await _at_start(config, digest, confinement, keys, stopped)
        if started is None:
            return
        in_force, services = started
        in_time = stack.enter_context(ending_in_time())
        outside = stack.enter_context(_listening(config, before)) if keys.credentials else None
        _begin_log(config, confinement, in_force)
        sockets = stack.enter_context(socket_folder(_beside_own_socket(config)))
        door = await stack.enter_async_context(_door(keys, on_traffic))
        runtime, lanes = await stack.enter_async_context(_runtime(config, door, sockets, confinement))
        services.know_lanes(lanes)
        metrics = _metrics(config)
        edge = EdgeServer(
            AdmissionController(
                offers(config, services.images),
                AdmissionSettings(
                    lease_s=config.lease_s, idle_stop_s=config.idle_stop_s, hold_s=config.hold_s
                ),
                peers=[peer.name for peer in config.peers],
            ),
            images=services.images,
            runtime=runtime,
            dialer=keys,
            peers={peer.name: peer.address for peer in config.peers},
            start_timeout_s=config.start_timeout_s,
            drain_s=config.drain_s,
            certificates=lambda: keys.certificates,
            at_door=lambda: door.refused if door else [],
            status=in_force.status,
            observer=metrics.observer() if metrics else Observer(),
        )
        edge.revoke(keys.revoked)
        reloads = Reloads(
            config_file,
            config,
            edge=edge,
            services=services,
            keys=keys,
            door=door,
            manager=manager,
            in_force=in_force,
            pass_on=before.reload if before else lambda: None,
        )
        stack.push_async_callback(edge.close)
        await take_up(edge, before)
        answering = await stack.enter_async_context(contextlib.AsyncExitStack())
        inside = GrpcSocket(f"{sockets}/daemon.sock") if door else None
        listener = _listener(config, inside, metrics.daemon(edge.handle) if metrics else edge.handle, stopped)
        address = await answering.enter_async_context(_answering(listener, door, inside, outside))
        if before is not None:
            before.ready()
        if metrics:
            metrics.look_at(edge)
            await answering.enter_async_context(_exposed(metrics, config, patient=before is not None))
        if config.announce:
            await answering.enter_async_context(_announcing(config, address))
        ready(", ".join(identity.name for identity in config.identities), address)
        manager.ready()
        daemon = RunningDaemon(config, edge, keys, reloads, outside, manager)
        for name, work in (
            ("the edge server", edge.run()),
            ("the operator's orders", reloads.run()),
            ("reloads by SIGHUP", _reload_at(hung_up, reloads)),
            ("the watch of certificates", watch_expiry(keys)),
            ("the service manager's watchdog", manager.heartbeat()),
        ):
            await stack.enter_async_context(beside(work, name=name))
        await stack.enter_async_context(taking_orders(partial(_obey, reloads, config_file)))
        await first(stopped.wait(), daemon.hand_over_at(asked_to_go))
        if not stopped.is_set():
            await answering.aclose()
            await first(stopped.wait(), edge.emptied())
        in_time(config.drain_s + _ENDING_S)
        manager.stopping("waiting for the calls under way")
        await edge.drain(_CLOSING)


def _require_discovery(config: DaemonConfig) -> None:
    """Raise UsageError if the daemon is announced, and what announces it is not installed."""
    if config.announce:
        with extra("discovery"):
            import upwash.real.network.discovery  # noqa: F401


async def _at_start(
    config: DaemonConfig, digest: str, confinement: Confinement, keys: DaemonKeys, stopped: asyncio.Event
) -> tuple[InForce, DaemonServices] | None:
    """What is in force now, and the services; None if the daemon is stopped while they are loaded."""
    loading = DaemonServices.found(config, confinement)
    services: DaemonServices | bool = await first(loading, stopped.wait())
    if isinstance(services, bool):
        return None
    in_force = InForce(keys, code=services.upwash, sandbox=confinement.kind(config))
    in_force.take(CONFIGURATION, digest)
    in_force.take(KEYS, keys.digest)
    in_force.take(REVOCATIONS, keys.digest_of_revoked)
    note_services(in_force, Services(services.images))
    return in_force, services


def _begin_log(config: DaemonConfig, confinement: Confinement, in_force: InForce) -> None:
    _log.info("%s", in_force.first_line())
    if confinement.warning:
        _log.warning("%s", confinement.warning)
    warn_without_list(config)


def _signals(stack: contextlib.AsyncExitStack) -> tuple[asyncio.Event, asyncio.Event, asyncio.Event]:
    """Events that signals set until the stack is closed: another daemon may come, the end, a reload."""
    asked_to_go, stopped, hung_up = asyncio.Event(), asyncio.Event(), asyncio.Event()
    stack.enter_context(stopping_politely(lambda _: stopped.set()))
    stack.enter_context(on_signal(signal.SIGHUP, hung_up.set))
    stack.enter_context(on_signal(signal.SIGUSR2, asked_to_go.set))
    return asked_to_go, stopped, hung_up


async def _reload_at(hung_up: asyncio.Event, reloads: Reloads) -> NoReturn:
    while True:
        await hung_up.wait()
        hung_up.clear()
        reloads.ask("SIGHUP")


async def _obey(reloads: Reloads, file: ConfigFile, order: str, by: str) -> Obeyed:
    match order:
        case "reload":
            refused = await reloads.ask(by)
        case "check":
            refused = await reloads.check()
        case _:
            refused = {"order": f"no such order: {printable(order)}"}
    return Obeyed(refused, str(file.path.absolute()))


def keep_heaps_few() -> None:
    """Have the threads of this process share two heaps, if its C library can do so.

    With a heap for each thread, the memory of closed connections is scattered, and the process needs twice as much.
    """
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 2)


# --- what it runs on ------------------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def _door(keys: DaemonKeys, on_traffic: OnTraffic) -> AsyncIterator[Door | None]:
    if keys.credentials is None:
        yield None
        return
    async with opened_door(keys.trust(), DoorLimits.of_this_process(), on_traffic=on_traffic) as door:
        yield door


@contextlib.asynccontextmanager
async def _runtime(
    config: DaemonConfig, door: Door | None, sockets: Path, confinement: Confinement
) -> AsyncIterator[tuple[Runtime, Mapping[str, int]]]:
    """What runs instances, and the lanes of services whose programs are in images."""
    host = config.listen.rpartition(":")[0]
    lead = leading(door, host, _instance_ports(config)) if door else None
    listen: Callable[[InstanceSpec], str] = lambda _: f"{host}:0"  # noqa: E731
    if lead or config.listen.startswith("unix:"):
        listen = sockets_in(sockets)
    if config.runtime.is_of_plug_in:
        engine: Engine = made(INSTANCES, config.runtime.kind, config.runtime.engine.settings)
        try:
            yield PlugInRuntime(engine, listen, lead=lead, max_message_bytes=config.max_message_bytes), {}
        finally:
            await engine.close()
    elif config.runtime.has_images:
        from upwash.launch.containers import containers

        limits, devices = confinement.limits(config), confinement.devices(config)
        async with containers(config, limits, devices, lead, sockets=sockets, listen=listen) as runtime:
            yield runtime, runtime.concurrency
    else:
        processes = ProcessRuntime(
            listen, lead=lead, max_message_bytes=config.max_message_bytes, sandbox=confinement.sandbox
        )
        yield processes, {}


def _instance_ports(config: DaemonConfig) -> Mapping[int, int]:
    """The ports of instances, each with the port that drones see; port 0 leaves the choice to the system."""
    if config.instance_ports is None:
        return {0: 0}
    first, last = config.instance_ports
    seen_first, _ = config.outside_ports or config.instance_ports
    return {port: port - first + seen_first for port in range(first, last + 1)}


def _beside_own_socket(config: DaemonConfig) -> Path | None:
    """The folder of the daemon's own socket, where drones may call sockets; None for a daemon at a port."""
    own = config.listen.removeprefix("unix:")
    return None if own == config.listen else Path(own).absolute().parent


def _listening(config: DaemonConfig, before: HandedOver | None) -> socket.socket:
    if before is not None:
        if before.listen != config.listen:
            raise UsageError("listen cannot change while the daemon runs: restart it")
        return before.listening()
    try:
        return listening_socket(config.listen)
    except OSError:
        raise cannot_listen(config.listen) from None


# --- requests -------------------------------------------------------------------------------------------------


def _listener(
    config: DaemonConfig, inside: GrpcSocket | None, handle: Handle, stopped: asyncio.Event
) -> Listener:
    loop = asyncio.get_running_loop()

    def answer_in_time(path: str, body: bytes, caller: Caller) -> bytes:
        answer = asyncio.run_coroutine_threadsafe(handle(path, body, caller.client), loop)
        try:
            return answer.result(timeout=min(caller.time_left_s() or _LONGEST_ANSWER_S, _LONGEST_ANSWER_S))
        except TimeoutError:
            answer.cancel()
            raise DeadlineExceeded("the drone's deadline is over") from None

    requests = Requests(
        answer_in_time,
        max_message_bytes=min(config.max_message_bytes, _LONGEST_REQUEST_BYTES),
        concurrent=_CONCURRENT_REQUESTS,
        per_drone=_REQUESTS_PER_DRONE,
    )
    address, who_is = (f"unix:{inside.path}", inside.client) if inside else (config.listen, None)
    listener = Listener(address, requests, who_is=who_is)
    listener.add(HealthCheck([at.name for at in config.identities], serving=lambda: not stopped.is_set()))
    return listener


@contextlib.asynccontextmanager
async def _answering(
    listener: Listener, door: Door | None, inside: GrpcSocket | None, outside: socket.socket | None
) -> AsyncIterator[str]:
    """Answer requests until the end of the block, through the door if there is one; yields the address."""
    listener.start()
    try:
        if door and inside and outside:
            entrance = await door.lead(outside, inside.connect)
            yield entrance.address
            await entrance.close()
        else:
            yield listener.address
    finally:
        await asyncio.to_thread(listener.stop, grace_s=_LAST_ANSWERS_S)


# --- metrics and announcement ---------------------------------------------------------------------------------


def _metrics(config: DaemonConfig) -> DaemonMetrics | None:
    if config.metrics is None:
        return None
    with extra("metrics"):
        from upwash.metrics.daemon import DaemonMetrics
    return DaemonMetrics()


@contextlib.asynccontextmanager
async def _exposed(metrics: DaemonMetrics, config: DaemonConfig, *, patient: bool) -> AsyncIterator[None]:
    """Offer the metrics until the end of the block; with `patient`, once the daemon before has stopped doing so."""
    from upwash.metrics.exposition import exposed

    def offered() -> contextlib.AbstractAsyncContextManager[str]:
        return exposed(
            metrics.registry, config.metrics or "", config.metrics_hosts, questions=metrics.questions
        )

    async def offer() -> None:
        while True:
            with contextlib.suppress(UsageError):
                async with offered():
                    await never()
            await asyncio.sleep(_METRICS_S)

    async with beside(offer(), name="the metrics") if patient else offered():
        yield


@contextlib.asynccontextmanager
async def _announcing(config: DaemonConfig, address: str) -> AsyncIterator[None]:
    """Announce the servers in the drones' networks; a failure is logged, and the daemon goes on."""
    from upwash.real.network.discovery import announcing

    host, _, port = address.rpartition(":")
    async with contextlib.AsyncExitStack() as announced:
        try:
            await announced.enter_async_context(
                announcing([at.name for at in config.identities], host, int(port))
            )
        except UpwashError as error:
            _log.error("the servers are not announced: %s", error)
        yield
