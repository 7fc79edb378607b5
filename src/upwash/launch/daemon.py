"""Puts the edge daemon on things: sockets, processes, signals, certificates, the service manager."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import signal
import socket
import tempfile
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from upwash.config import DaemonConfig
from upwash.config.daemon import ImageConfig
from upwash.core.admission.admission import AdmissionController, AdmissionSettings, ServerOffer
from upwash.core.admission.clients import Client
from upwash.core.admission.instances import InstanceState
from upwash.core.admission.watchdog import CALL_LIMIT_S
from upwash.errors import Refused, UpwashError, UsageError
from upwash.launch.confinement import Confinement, find_confinement
from upwash.launch.daemon_keys import DaemonKeys, watch_expiry
from upwash.launch.daemon_services import DaemonServices
from upwash.ports import InstanceSpec, Runtime
from upwash.real.host.log import RateLimitedLog
from upwash.real.host.service_manager import ServiceManager
from upwash.real.host.signals import ending_in_time, on_signal, stopping_politely
from upwash.real.instances.runtime import ProcessRuntime, sockets_in
from upwash.real.link.door import Door, OnTraffic, leading, opened_door
from upwash.real.link.hand_over import HandedOver, Served, Used, hand_over
from upwash.real.link.limits import DoorLimits
from upwash.real.link.listener import HealthCheck, Listener, cannot_listen
from upwash.real.link.proxy import GrpcSocket
from upwash.real.link.requests import Caller, Requests
from upwash.real.link.streams import listening_socket
from upwash.server.daemon import EdgeServer, Image
from upwash.support.background import beside
from upwash.support.loading import extra
from upwash.support.waiting import first, never

if TYPE_CHECKING:
    from upwash.metrics.daemon import DaemonMetrics

_log = logging.getLogger("upwash.serving")
Handle = Callable[[str, bytes, Client], Coroutine[Any, Any, bytes]]

_CONCURRENT_REQUESTS = 128  # most take no time, a start as long as the service needs
_REQUESTS_PER_DRONE = 8
_LONGEST_REQUEST_BYTES = 2**20  # photos go to instances
_LONGEST_ANSWER_S = 600.0  # to who sets no deadline
_LAST_ANSWERS_S = 5.0
_COMING_S = 30.0  # for a daemon to come up, beside its services
_METRICS_S = 0.5  # between two looks at whether the daemon before still offers its metrics
_ENDING_S = 30.0  # for all that follows the calls under way
_PACES = 10.0  # a call may take that many times the slowest pace
logging.getLogger("upwash.usage").addFilter(RateLimitedLog())  # a drone may come and go as often as it likes
_CLOSING = "this edge server is shutting down"


async def serve(
    config: DaemonConfig,
    *,
    read_again: Callable[[], DaemonConfig],
    ready: Callable[[str], None],
    manager: ServiceManager,
    before: HandedOver | None = None,
) -> None:
    """Runs the daemon until SIGTERM or Ctrl-C, by which calls under way get `drain_s`; `ready` is told the address.

    SIGHUP has the configuration read again, and SIGUSR2 has this program, as it is on the disk by then, take the
    daemon's place. It takes that of the daemon `before`, if there was one.
    """
    if config.announce:
        with extra("discovery"):
            import upwash.real.network.discovery  # noqa: F401 - before anything is begun
    confinement = await find_confinement(config)
    services = DaemonServices(config, confinement)
    keys = DaemonKeys(config)
    loop = asyncio.get_running_loop()

    def on_traffic(server: str, drone: str) -> None:  # by the door, in its own thread
        loop.call_soon_threadsafe(edge.seen, server, drone)

    async with contextlib.AsyncExitStack() as stack:
        in_time = stack.enter_context(ending_in_time())
        outside = stack.enter_context(_listening(config, before)) if keys.credentials else None
        sockets = Path(stack.enter_context(_folder_for_sockets(config)))
        door = await stack.enter_async_context(_door(keys, on_traffic))
        runtime, lanes = await stack.enter_async_context(_runtime(config, door, sockets, confinement))
        services.know_lanes(lanes)
        metrics = _metrics(config)
        edge = await _edge_server(
            config, services.images, metrics.runtime(runtime) if metrics else runtime, keys, door
        )
        handle = metrics.daemon(edge.handle) if metrics else edge.handle
        hung_up, asked_to_go, stopped = asyncio.Event(), asyncio.Event(), asyncio.Event()
        stack.enter_context(stopping_politely(lambda _: stopped.set()))
        stack.enter_context(on_signal(signal.SIGHUP, hung_up.set))
        stack.enter_context(on_signal(signal.SIGUSR2, asked_to_go.set))
        stack.push_async_callback(edge.close)
        await _take_up(edge, before)
        answering = await stack.enter_async_context(contextlib.AsyncExitStack())
        address = await answering.enter_async_context(
            _answering(config, door, outside, sockets, handle, serving=lambda: not stopped.is_set())
        )
        if before is not None:
            before.ready()
        if metrics:
            await answering.enter_async_context(_exposed(metrics, edge, config, patient=before is not None))
        if config.announce:
            await answering.enter_async_context(_announcing(config, address))
        if confinement.weakness:
            _log.warning("%s", confinement.weakness)
        ready(address)
        manager.ready()
        reloading = _reload_at(
            hung_up,
            config,
            read_again=read_again,
            edge=edge,
            services=services,
            keys=keys,
            door=door,
            manager=manager,
        )
        for name, work in (
            ("the edge server", edge.run()),
            ("the watch for another configuration", reloading),
            ("the watch of certificates", watch_expiry(keys)),
        ):
            await stack.enter_async_context(beside(work, name=name))
        await first(stopped.wait(), _hand_over(asked_to_go, config, outside, edge, manager))
        if not stopped.is_set():
            await answering.aclose()
            await first(stopped.wait(), edge.emptied())
        in_time(config.drain_s + _ENDING_S)
        manager.stopping("waiting for the calls under way")
        await edge.drain(_CLOSING)


async def _edge_server(
    config: DaemonConfig, images: Mapping[str, Image], runtime: Runtime, keys: DaemonKeys, door: Door | None
) -> EdgeServer:
    settings = AdmissionSettings(lease_s=config.lease_s, idle_stop_s=config.idle_stop_s, hold_s=config.hold_s)
    peers = {peer.name: peer.address for peer in config.peers}
    offers = _offers(config, images)
    edge = EdgeServer(
        AdmissionController(offers, settings, peers=list(peers)),
        images=images,
        runtime=runtime,
        dialer=keys,
        peers=peers,
        start_timeout_s=config.start_timeout_s,
        drain_s=config.drain_s,
        certificates=keys.certificates,
        at_door=lambda: door.refused if door else [],
    )
    await edge.reload(offers, images=images, revoked=keys.revoked, certificates=keys.certificates)
    return edge


@contextlib.asynccontextmanager
async def _answering(
    config: DaemonConfig,
    door: Door | None,
    outside: socket.socket | None,
    sockets: Path,
    handle: Handle,
    *,
    serving: Callable[[], bool],
) -> AsyncIterator[str]:
    """Has requests answered until the end of the block, through the door if there is one; yields the address."""
    inside = GrpcSocket(f"{sockets}/daemon.sock") if door else None
    listener = _listener(config, inside, handle)
    listener.add(HealthCheck([each.name for each in config.identities], serving=serving))
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


def _offers(config: DaemonConfig, images: Mapping[str, Image]) -> dict[str, ServerOffer]:
    lanes = {name: image.lanes for name, image in images.items()}
    limits_s = {each.name: each.call_limit_s or _call_limit_s(each) for each in config.images}
    return {
        each.name: ServerOffer(frozenset(each.images), each.slots, each.turn_s, lanes, limits_s)
        for each in config.identities
    }


def _call_limit_s(image: ImageConfig) -> float:
    return max(CALL_LIMIT_S, _PACES * max(image.pace_s.values(), default=0.0))


@contextlib.asynccontextmanager
async def _door(keys: DaemonKeys, on_traffic: OnTraffic) -> AsyncIterator[Door | None]:
    """Where certificates are looked at, if there are any."""
    if keys.credentials is None:
        yield None
        return
    async with opened_door(keys.trust(), DoorLimits.of_this_process(), on_traffic=on_traffic) as door:
        yield door


@contextlib.asynccontextmanager
async def _runtime(
    config: DaemonConfig, door: Door | None, sockets: Path, confinement: Confinement
) -> AsyncIterator[tuple[Runtime, Mapping[str, int]]]:
    """What runs instances, and the lanes of services by their images, where it runs them from images."""
    lead = leading(door, config.listen.rpartition(":")[0], _instance_ports(config)) if door else None
    listen = sockets_in(sockets) if lead else _beside(config.listen, sockets)
    if config.runtime.kind != "process":
        from upwash.launch.containers import containers

        limits = confinement.limits(config)
        async with containers(config, limits, lead, sockets=sockets, listen=listen) as runtime:
            yield runtime, runtime.concurrency
    else:
        processes = ProcessRuntime(
            listen,
            lead=lead,
            max_message_bytes=config.max_message_bytes,
            sandbox=confinement.sandbox,
        )
        yield processes, {}


def _instance_ports(config: DaemonConfig) -> Mapping[int, int]:
    """Where instances are reached, each with the port that drones see; 0 is a port of the system's choice."""
    if config.instance_ports is None:
        return {0: 0}
    first, last = config.instance_ports
    seen_first, _ = config.outside_ports or config.instance_ports
    return {port: port - first + seen_first for port in range(first, last + 1)}


def _folder_for_sockets(config: DaemonConfig) -> tempfile.TemporaryDirectory[str]:
    """Beside the daemon's own socket, if it has one: drones call no other sockets than those below its folder."""
    own = config.listen.removeprefix("unix:")
    beside = None if own == config.listen else Path(own).absolute().parent
    return tempfile.TemporaryDirectory(prefix="u-", dir=beside)


def _beside(listen: str, sockets: Path) -> Callable[[InstanceSpec], str]:
    """Instances listen on the daemon's own interface, on ports of the system's choice."""
    if listen.startswith("unix:"):
        return sockets_in(sockets)
    host = listen.rpartition(":")[0]
    return lambda _: f"{host}:0"


def _listening(config: DaemonConfig, before: HandedOver | None) -> socket.socket:
    """The socket of the daemon before, or one of its own."""
    if before is not None:
        if before.listen != config.listen:
            raise UsageError("listen cannot change while the daemon runs: restart it")
        return before.listening()
    try:
        return listening_socket(config.listen)
    except OSError:
        raise cannot_listen(config.listen) from None


# --- another program ----------------------------------------------------------------------------------------


async def _take_up(edge: EdgeServer, before: HandedOver | None) -> None:
    """Serves whom the daemon before served, with what ran there."""
    for server, served in (before.servers if before is not None else {}).items():
        drones = [Client(name, certificate) for name, certificate in served.drones]
        await edge.take_up(server, drones, served.services)
    for server, used in (before.usage() if before is not None else {}).items():
        edge.take_up_usage(server, used.drones, used.teams)


async def _hand_over(
    asked: asyncio.Event,
    config: DaemonConfig,
    outside: socket.socket | None,
    edge: EdgeServer,
    manager: ServiceManager,
) -> None:
    """Returns once another daemon has taken this one's place, when asked for; what keeps it from that is logged."""
    while True:
        await asked.wait()
        asked.clear()
        if outside is None or config.runtime.kind != "process":
            _log.error(
                "no other daemon can take this one's place, as that needs certificates, and services that are "
                "processes: restart it"
            )
            continue
        _log.info("another daemon is to take this one's place")
        try:
            process = await hand_over(
                outside,
                config.listen,
                _served(edge),
                {each.name: Used(each.drones, each.teams) for each in edge.standing().servers},
                environment=manager.environment,
                timeout_s=config.start_timeout_s + _COMING_S,
            )
        except (UpwashError, OSError) as error:
            _log.error("this daemon stays: %s", error)
            continue
        except Exception:  # noqa: BLE001 - a defect must not take the drones' leases
            _log.exception("this daemon stays: a defect in handing over")
            continue
        manager.main_is(process)
        _log.info("process %d has taken this daemon's place, which ends when its last lease does", process)
        return


def _served(edge: EdgeServer) -> dict[str, Served]:
    return {
        each.name: Served(
            [(lease.drone, lease.certificate) for lease in each.leases if not lease.held_by],
            [instance.service for instance in each.instances if instance.state == InstanceState.RUNNING],
        )
        for each in edge.standing().servers
    }


# --- requests -----------------------------------------------------------------------------------------------


def _listener(config: DaemonConfig, inside: GrpcSocket | None, handle: Handle) -> Listener:
    loop = asyncio.get_running_loop()

    def answer_in_time(path: str, body: bytes, caller: Caller) -> bytes:
        answer = asyncio.run_coroutine_threadsafe(handle(path, body, caller.client), loop)
        try:
            return answer.result(timeout=min(caller.time_left_s() or _LONGEST_ANSWER_S, _LONGEST_ANSWER_S))
        except TimeoutError:
            answer.cancel()
            raise Refused("the drone's deadline is over") from None

    requests = Requests(
        answer_in_time,
        max_message_bytes=min(config.max_message_bytes, _LONGEST_REQUEST_BYTES),
        concurrent=_CONCURRENT_REQUESTS,
        each=_REQUESTS_PER_DRONE,
    )
    return Listener(
        f"unix:{inside.path}" if inside else config.listen,
        requests,
        who_is=inside.client if inside else None,
    )


# --- metrics -----------------------------------------------------------------------------------------------


def _metrics(config: DaemonConfig) -> DaemonMetrics | None:
    if config.metrics is None:
        return None
    with extra("metrics"):
        from upwash.metrics.daemon import DaemonMetrics
    return DaemonMetrics()


@contextlib.asynccontextmanager
async def _exposed(
    metrics: DaemonMetrics, edge: EdgeServer, config: DaemonConfig, *, patient: bool
) -> AsyncIterator[None]:
    """Offers the metrics until the end of the block; with `patient` once the daemon before does so no more."""
    from upwash.metrics.exposition import exposed

    metrics.look_at(edge)
    offered = functools.partial(exposed, metrics.registry, config.metrics or "", config.metrics_hosts)

    async def offer() -> None:
        while True:
            with contextlib.suppress(UsageError):
                async with offered():
                    await never()
            await asyncio.sleep(_METRICS_S)

    if not patient:
        async with offered():
            yield
        return
    async with beside(offer(), name="the metrics"):
        yield


@contextlib.asynccontextmanager
async def _announcing(config: DaemonConfig, address: str) -> AsyncIterator[None]:
    """Has drones find the servers in their networks; a daemon that cannot do that serves all the same."""
    from upwash.real.network.discovery import announcing

    host, _, port = address.rpartition(":")
    async with contextlib.AsyncExitStack() as announced:
        try:
            await announced.enter_async_context(
                announcing([each.name for each in config.identities], host, int(port))
            )
        except UpwashError as error:
            _log.error("the servers are not announced: %s", error)
        yield


# --- another configuration ----------------------------------------------------------------------------------


async def _reload_at(
    hung_up: asyncio.Event,
    config: DaemonConfig,
    *,
    read_again: Callable[[], DaemonConfig],
    edge: EdgeServer,
    services: DaemonServices,
    keys: DaemonKeys,
    door: Door | None,
    manager: ServiceManager,
) -> NoReturn:
    """Has the edge server follow the configuration, at each hang-up; one that cannot be followed changes nothing."""
    while True:
        await hung_up.wait()
        hung_up.clear()
        manager.reloading()
        try:
            new = await asyncio.to_thread(read_again)
            _refuse_restart(config, new)
            images = await services.anew(new)
            keys.renew(new)
        except UpwashError as error:
            _log.error("the old configuration stays: %s", error)
        else:
            if door:
                await door.trust(keys.trust())
            changed = services.take(new, images)
            await edge.reload(
                _offers(new, images), images=images, revoked=keys.revoked, certificates=keys.certificates
            )
            _log.info(
                "the configuration was read again; %d certificates are revoked; services that changed: %s",
                len(keys.revoked),
                ", ".join(changed) or "none",
            )
        manager.ready()


def _refuse_restart(old: DaemonConfig, new: DaemonConfig) -> None:
    """Raises UsageError where the two differ in what a running daemon cannot change."""
    if [each.name for each in old.identities] != [each.name for each in new.identities]:
        raise UsageError("another server cannot join a daemon that runs, nor leave it: restart it")
    if (old.keys is None) != (new.keys is None):
        raise UsageError("a daemon that runs cannot begin or cease to use certificates: restart it")
    if old.runtime.kind != "process" and old.images != new.images:
        raise UsageError("the services of containers are prepared at the start: restart it")
    for name in sorted(set(old.__struct_fields__) - {"images", "identities", "keys"}):
        if getattr(old, name) != getattr(new, name):
            raise UsageError(f"{name} cannot change while the daemon runs: restart it")
