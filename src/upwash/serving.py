"""Puts the edge daemon on things: sockets, processes, signals, certificates, the service manager."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import tempfile
from collections.abc import AsyncIterator, Callable, Coroutine
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import msgspec
from grpc_health.v1 import health, health_pb2, health_pb2_grpc

from upwash.bundled import load_services
from upwash.config import DaemonConfig
from upwash.core.instances import Host, HostSettings, ServerOffer
from upwash.core.visitors import Visitor
from upwash.errors import CredentialsError, Refused, UpwashError, UsageError
from upwash.loading import extra
from upwash.ports import InstanceSpec, Program, Runtime
from upwash.protocol import CertificateStatus
from upwash.real.credentials import Credentials, read_credentials, read_revoked
from upwash.real.link import GrpcDialer
from upwash.real.listener import Caller, Listener
from upwash.real.runtime import ProcessRuntime, sockets_in
from upwash.real.sandbox import Limits, Sandbox, find_sandbox
from upwash.real.service_manager import ServiceManager
from upwash.real.signals import on_hangup, stopping_politely
from upwash.server import EdgeServer, Image

if TYPE_CHECKING:
    from upwash.metrics.daemon import DaemonMetrics

_log = logging.getLogger("upwash.serving")
Handle = Callable[[str, bytes, Visitor], Coroutine[Any, Any, bytes]]

_CONCURRENT_REQUESTS = 128  # most take no time, a start as long as the service needs
_REQUESTS_PER_DRONE = 8
_LONGEST_REQUEST_BYTES = 2**20  # photos go to instances
_EXPIRY_WARNING = timedelta(days=30)
_EXPIRY_LOOK_S = 86_400.0
_CLOSING = "this edge server is shutting down"


async def serve(
    config: DaemonConfig,
    *,
    read_again: Callable[[], DaemonConfig],
    ready: Callable[[str], None],
    manager: ServiceManager,
) -> None:
    """Runs the daemon until SIGTERM or Ctrl-C, by which calls under way get `drain_s`; `ready` is told the address.

    SIGHUP has the configuration read again.
    """
    images = _images(config)
    credentials = _credentials(config)
    revoked = _revoked(config)
    sandbox, weakness = await asyncio.to_thread(_sandbox, config)
    async with contextlib.AsyncExitStack() as stack:
        sockets = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="upwash-")))
        runtime = await stack.enter_async_context(_runtime(config, credentials, sockets, sandbox))
        metrics = _metrics(config)
        edge = EdgeServer(
            Host(
                _offers(config),
                HostSettings(lease_s=config.lease_s, idle_stop_s=config.idle_stop_s, hold_s=config.hold_s),
                peers=[peer.name for peer in config.peers],
            ),
            images=images,
            runtime=metrics.runtime(runtime) if metrics else runtime,
            dialer=GrpcDialer(
                config.identities[0].name, credentials, max_message_bytes=config.max_message_bytes
            ),
            peers={peer.name: peer.address for peer in config.peers},
            start_timeout_s=config.start_timeout_s,
            drain_s=config.drain_s,
            certificates=_certificates(credentials),
        )
        await edge.reload(_offers(config), images=images, revoked=revoked)
        handle = metrics.daemon(edge.handle) if metrics else edge.handle
        listener = _listener(config, credentials, handle)
        health = _health(config, listener)
        hung_up, stopped = asyncio.Event(), asyncio.Event()
        stack.enter_context(stopping_politely(lambda _: stopped.set()))
        stack.enter_context(on_hangup(hung_up.set))
        listener.start()
        stack.push_async_callback(edge.close)
        stack.push_async_callback(asyncio.to_thread, listener.stop)
        if metrics and config.metrics:
            from upwash.metrics.exposition import exposed

            metrics.look_at(edge)
            await stack.enter_async_context(exposed(metrics.registry, config.metrics))
        if weakness:
            _log.warning("%s", weakness)
        ready(listener.address)
        manager.ready()
        for work in (
            edge.run(),
            _reload_at(hung_up, config, read_again=read_again, edge=edge, manager=manager),
            _watch_expiry(_certificates(credentials)),
        ):
            stack.callback(asyncio.create_task(work).cancel)
        await stopped.wait()
        health.enter_graceful_shutdown()
        manager.stopping("waiting for the calls under way")
        await edge.drain(_CLOSING)


def _images(config: DaemonConfig) -> dict[str, Image]:
    """What each service is; in a container its program is the image's, and checks its settings there."""
    if config.runtime.kind == "lxd":
        programs = {
            each.name: Program("", each.settings.values if each.settings else {}) for each in config.images
        }
    else:
        programs = {name: service.program for name, service in load_services(config.images).items()}
    return {each.name: Image(programs[each.name], each.pace_s, each.start_pace_s) for each in config.images}


def _offers(config: DaemonConfig) -> dict[str, ServerOffer]:
    return {each.name: ServerOffer(frozenset(each.images), each.slots) for each in config.identities}


def _sandbox(config: DaemonConfig) -> tuple[Sandbox | None, str]:
    """The sandbox for services, and its weakness if any; raises UsageError where a required one is not to be had."""
    runtime = config.runtime
    if runtime.kind == "lxd":
        return None, ""
    if runtime.sandbox == "off":
        return None, "services run without a sandbox, as runtime.sandbox says"
    limits = Limits(runtime.memory_bytes, runtime.processes, runtime.disk_bytes)
    try:
        sandbox = find_sandbox(limits, readable=runtime.readable)
    except UsageError as error:
        if runtime.sandbox == "required":
            raise
        return None, f"services run without a sandbox: {error}"
    if os.geteuid() == 0:
        return sandbox, "the daemon is root: services in their sandbox may start processes without limit"
    return sandbox, ""


@contextlib.asynccontextmanager
async def _runtime(
    config: DaemonConfig, credentials: Credentials | None, sockets: Path, sandbox: Sandbox | None
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
            sandbox=sandbox,
        )


def _beside(listen: str, sockets: Path) -> Callable[[InstanceSpec], str]:
    """Instances listen on the daemon's own interface, on ports of the system's choice."""
    if listen.startswith("unix:"):
        return sockets_in(sockets)
    host = listen.rpartition(":")[0]
    return lambda _: f"{host}:0"


# --- requests -----------------------------------------------------------------------------------------------


def _listener(config: DaemonConfig, credentials: Credentials | None, handle: Handle) -> Listener:
    loop = asyncio.get_running_loop()

    def answer_in_time(path: str, body: bytes, caller: Caller) -> bytes:
        answer = asyncio.run_coroutine_threadsafe(handle(path, body, caller.visitor), loop)
        try:
            return answer.result(timeout=caller.time_left_s())
        except TimeoutError:
            answer.cancel()
            raise Refused("the drone's deadline is over") from None

    return Listener(
        config.listen,
        answer_in_time,
        credentials=credentials,
        max_message_bytes=min(config.max_message_bytes, _LONGEST_REQUEST_BYTES),
        concurrent_requests=_CONCURRENT_REQUESTS,
        requests_per_drone=_REQUESTS_PER_DRONE,
    )


def _health(config: DaemonConfig, listener: Listener) -> health.HealthServicer:
    """The standard health service, for the daemon and for each of its servers."""
    servicer = health.HealthServicer()
    health_pb2_grpc.add_HealthServicer_to_server(servicer, listener.grpc_server)
    for name in ("", *(each.name for each in config.identities)):
        servicer.set(name, health_pb2.HealthCheckResponse.SERVING)
    return servicer


# --- metrics -----------------------------------------------------------------------------------------------


def _metrics(config: DaemonConfig) -> DaemonMetrics | None:
    if config.metrics is None:
        return None
    with extra("metrics"):
        from upwash.metrics.daemon import DaemonMetrics
    return DaemonMetrics()


# --- certificates -------------------------------------------------------------------------------------------


def _credentials(config: DaemonConfig) -> Credentials | None:
    if config.keys is None:
        return None
    credentials = read_credentials(config.keys.authority, config.keys.certificate, config.keys.key)
    names = ",".join(identity.name for identity in config.identities)
    remedy = f"make one with `upwash keys DIR --server {names}`"
    for identity in config.identities:
        if identity.name not in credentials.names:
            raise CredentialsError(
                f"the certificate is for {', '.join(credentials.names)}, but this daemon acts as "
                f"{identity.name}: {remedy}"
            )
    if not credentials.is_for("serving") or (config.peers and not credentials.is_for("calling")):
        raise CredentialsError(f"{config.keys.certificate}: not a certificate for a daemon: {remedy}")
    return None if config.listen.startswith("unix:") else credentials


def _revoked(config: DaemonConfig) -> frozenset[str]:
    file = config.keys.revoked if config.keys else None
    return read_revoked(file) if file else frozenset()


def _certificates(credentials: Credentials | None) -> list[CertificateStatus]:
    expiries = credentials.expiries if credentials else {}
    return [CertificateStatus(holder, expires) for holder, expires in expiries.items()]


async def _watch_expiry(certificates: list[CertificateStatus]) -> NoReturn:
    """Warns of certificates that end soon, every day."""
    while True:
        for each in certificates:
            left = each.expires - datetime.now(UTC)
            level = logging.WARNING if left < _EXPIRY_WARNING else logging.INFO
            _log.log(
                level, "the certificate of %s ends in %d days, on %s", each.holder, left.days, each.expires
            )
        await asyncio.sleep(_EXPIRY_LOOK_S)


# --- another configuration ----------------------------------------------------------------------------------


async def _reload_at(
    hung_up: asyncio.Event,
    config: DaemonConfig,
    *,
    read_again: Callable[[], DaemonConfig],
    edge: EdgeServer,
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
            revoked = _revoked(new)
            images = await asyncio.to_thread(_images, new)
        except UpwashError as error:
            _log.error("the old configuration stays: %s", error)
        else:
            await edge.reload(_offers(new), images=images, revoked=revoked)
            _log.info("the configuration was read again; %d certificates are revoked", len(revoked))
        manager.ready()


def _refuse_restart(old: DaemonConfig, new: DaemonConfig) -> None:
    """Raises UsageError where the two differ in what a running daemon cannot change."""
    if [each.name for each in old.identities] != [each.name for each in new.identities]:
        raise UsageError("another server cannot join a daemon that runs, nor leave it: restart it")
    if (old.keys and msgspec.structs.replace(old.keys, revoked=None)) != (
        new.keys and msgspec.structs.replace(new.keys, revoked=None)
    ):
        raise UsageError("keys cannot change while the daemon runs, but for keys.revoked: restart it")
    if old.runtime.kind == "lxd" and old.images != new.images:
        raise UsageError("the services of containers are prepared at the start: restart it")
    for name in sorted(set(old.__struct_fields__) - {"images", "identities", "keys"}):
        if getattr(old, name) != getattr(new, name):
            raise UsageError(f"{name} cannot change while the daemon runs: restart it")
