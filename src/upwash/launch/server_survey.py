"""Asks each server, before a flight, for all that a flight asks of it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from upwash.config import DroneConfig, ServerConfig
from upwash.core.knowledge.estimates import Estimates
from upwash.core.policies.policy import Deadline
from upwash.core.selection.radios import check_limit_s
from upwash.drone.preparation import endpoints, make_estimates
from upwash.drone.server_session import ServerEndpoint, ServerSession
from upwash.errors import DeadlineExceeded, Unreachable, UpwashError
from upwash.launch.drone import (
    drone_credentials,
    require_address,
    require_certificates,
    server_dialer,
    server_finder,
)
from upwash.launch.networks import network_on_the_ground
from upwash.launch.photos import Look, look
from upwash.launch.trials import call_limit_s, requests_of, trials
from upwash.missions.bundled import load_specs
from upwash.ports import Network
from upwash.profiling.profiler import CallSample, require_answer
from upwash.real.link.link import GrpcDialer
from upwash.real.network import SurveyFinding
from upwash.rpc.service import ServiceSpec
from upwash.sim.journal import MemoryJournal
from upwash.support.background import beside
from upwash.support.text import command

_OTHER_PORTS = (
    "the daemon answers, and the port of this service does not: calls go to the ports of instance_ports in the "
    "daemon's file, which have to lead to that computer under the same numbers, or under those of outside_ports"
)


@dataclass(frozen=True, slots=True)
class _Wanted:
    """What the drone has, and wants of each server."""

    config: DroneConfig
    specs: Mapping[str, ServiceSpec]
    estimates: Estimates
    photos: Mapping[str, bytes]
    dialer: GrpcDialer

    def of(self, endpoint: ServerEndpoint) -> list[CallSample]:
        """The calls that a flight may make there."""
        return [
            sample
            for service in endpoint.services
            for sample in trials(self.specs[service], self.estimates, self.photos)
            if self.estimates.is_hosted(endpoint.name, sample.operation)
        ]


async def survey_servers(config: DroneConfig) -> list[SurveyFinding]:
    """Whether each server can be used: its network joined, the drone's services started, each of them called.

    A call has a photo of the drone's camera, if the service takes one. Raises CredentialsError where the drone's
    certificate cannot be shown, and NetworkError where no network can be joined at all.
    """
    seen, findings = await _photos(config)
    specs = load_specs(config.services)
    estimates = make_estimates(config, specs)
    wanted = _Wanted(config, specs, estimates, seen.photos, server_dialer(config, drone_credentials(config)))
    reached = endpoints(config, estimates, server_finder(config))
    journal = MemoryJournal()
    journal.begin()
    async with contextlib.AsyncExitStack() as stack:
        network = await network_on_the_ground(config, journal, stack)
        at_a_time = asyncio.Semaphore(1 if config.network.kind == "networkmanager" else max(1, len(reached)))

        async def survey(server: ServerConfig) -> SurveyFinding:
            async with at_a_time:
                return await _survey(server, reached[server.name], wanted, network)

        return findings + await asyncio.gather(*map(survey, config.servers))


async def _photos(config: DroneConfig) -> tuple[Look, list[SurveyFinding]]:
    """What the camera gives, with what is wrong with it."""
    try:
        seen = await look(config)
    except UpwashError as error:
        return Look({}), [SurveyFinding("camera", "gives no photo", str(error))]
    return seen, [
        SurveyFinding("camera", f"gives {', '.join(seen.photos) or 'nothing'}", each)
        for each in seen.troubles
    ]


async def _survey(
    server: ServerConfig, endpoint: ServerEndpoint, wanted: _Wanted, network: Network
) -> SurveyFinding:
    subject = f"{server.name} at {server.address or '?'}"
    try:
        require_address(server)
        require_certificates(server, wanted.config)
    except UpwashError as error:
        return SurveyFinding(subject, "not asked", str(error))
    session = ServerSession(endpoint, network=network, dialer=wanted.dialer)
    found = "is not reached"
    try:
        await session.join(timeout_s=check_limit_s(server.check_running_s))
        found = "does not answer as needed"
        now_s = asyncio.get_running_loop().time
        began_s = now_s()
        running = (await session.ask()).running
        found = "answers"
        if not running:
            await session.start_patiently(within_s=wanted.config.start_timeout_s)
        found = _started(server, endpoint.services, running=running, took_s=now_s() - began_s)
        async with beside(session.keep_lease(), name=f"the lease at {session.server}"):
            found += await _called(session, server, wanted, wanted.of(endpoint))
    except UpwashError as error:
        return SurveyFinding(subject, found, str(error).removeprefix(f"{subject}: "))
    finally:
        await session.end(in_range=True)
    return SurveyFinding(subject, found)


def _started(server: ServerConfig, services: Sequence[str], *, running: bool, took_s: float) -> str:
    believed_s = server.check_running_s if running else server.check_s
    did, key = ("runs", "check_running_s") if running else ("started", "check_s")
    return f"{did} {', '.join(services) or 'nothing that the drone wants'} in {took_s:.1f} s ({key} = {believed_s:g})"


async def _called(
    session: ServerSession, server: ServerConfig, wanted: _Wanted, found: list[CallSample]
) -> str:
    """Makes each call, over the way that a flight's calls take; returns what the first of each operation took."""
    said: dict[str, str] = {}
    for sample, photo, request in requests_of(found):
        took_s = await _call(session, wanted, sample, photo, request)
        said.setdefault(str(sample.operation), f", called {sample.operation} in {took_s:.2f} s")
        local_s = wanted.estimates.local_s(sample.operation)
        remote_s = wanted.estimates.remote_s(server.name, sample.operation)
        if local_s is None or remote_s is None:
            continue
        waits_s = Deadline().seconds(local_s=local_s, remote_s=remote_s)
        if took_s > waits_s and (again_s := await _call(session, wanted, sample, photo, request)) > waits_s:
            raise UpwashError(
                f"{sample.operation} takes {again_s:.2f} s there, and a flight waits {waits_s:.2f} s for it: measure "
                f"it with {_measured(server, sample)}"
            )
    if not found:
        await _probed(session)
    return "".join(said.values())


async def _call(
    session: ServerSession, wanted: _Wanted, sample: CallSample, photo: str, request: bytes
) -> float:
    now_s, operation = asyncio.get_running_loop().time, sample.operation
    began_s = now_s()
    limit_s = call_limit_s(wanted.estimates.local_s(operation))
    try:
        reply = await session.call(operation.service, operation.method, request, deadline_s=limit_s)
    except (Unreachable, DeadlineExceeded) as error:
        if trouble := await wanted.dialer.trouble(session.server):
            raise Unreachable(f"{session.server}: {trouble}") from error
        if isinstance(error, Unreachable):
            raise Unreachable(f"{error}: {_OTHER_PORTS}") from error
        raise
    took_s = now_s() - began_s
    require_answer(sample, photo, reply)
    return took_s


async def _probed(session: ServerSession) -> None:
    """Sees that the services, none of which takes a photo alone, are reached."""
    try:
        await session.probe()
    except Unreachable as error:
        raise Unreachable(f"{error}: {_OTHER_PORTS}") from error


def _measured(server: ServerConfig, sample: CallSample) -> str:
    service = sample.operation.service
    return command(
        "upwash", "profile", service, "--config", "CONFIG", "--server", server.name, "--photos", "DIR"
    )
