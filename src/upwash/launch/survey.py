"""Tries, before a flight, all that it will use: the vehicle, the networks, the servers and the own services."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from upwash.config.drone import DroneConfig, ServerConfig
from upwash.core.knowledge.estimates import Estimates
from upwash.core.operation import ON_DRONE
from upwash.core.policies.policy import Deadline
from upwash.core.selection.radios import check_limit_s
from upwash.drone.onboard import started
from upwash.drone.preparation import endpoints, make_estimates
from upwash.drone.server_session import ServerEndpoint, ServerSession
from upwash.errors import AutopilotRefused, DeadlineExceeded, Unreachable, UpwashError, UsageError
from upwash.eventlog.schema import VehicleSetting
from upwash.launch.cameras import Look, look
from upwash.launch.drone import (
    connect_vehicle,
    drone_credentials,
    network_on_the_ground,
    require_address,
    require_certificates,
    server_dialer,
    server_finder,
)
from upwash.missions.bundled import load_services, load_specs
from upwash.ports import InstanceSpec, Network, VehicleNews
from upwash.profiling.boxes import told_boxes
from upwash.profiling.profiler import CallSample, answer_of, samples
from upwash.real.instances.runtime import OwnProcesses
from upwash.real.link.link import GrpcDialer
from upwash.real.mavlink import MavlinkAutopilot
from upwash.real.network import SurveyFinding
from upwash.rpc.protocol import service_path
from upwash.rpc.service import ServiceSpec, spec_of
from upwash.sim.journal import MemoryJournal
from upwash.support.background import beside
from upwash.support.loading import extra
from upwash.support.text import command

_OTHER_PORTS = (
    "the daemon answers, and the port of this service does not: calls go to the ports of instance_ports in the "
    "daemon's file, which have to lead to that computer under the same numbers, or under those of outside_ports"
)
_LEAST_CALL_S = 60.0  # the first call after a start may have much to load


@dataclass(frozen=True, slots=True)
class VehicleSurvey:
    """The vehicle that answered, and what its dead man lacks; empty for a dead man that is ready.

    `version` is its firmware's, or empty. `unfit` is why the vehicle cannot be flown, or empty. `settings` are the
    parameters that a person should know before a flight.
    """

    vehicle: str
    version: str
    unfit: str
    settings: Sequence[VehicleSetting]
    dead_man_lacks: str


async def survey_vehicle(config: DroneConfig, *, install_dead_man: bool) -> VehicleSurvey:
    """What the configured vehicle says of itself; with `install_dead_man` it is given its dead man first."""
    autopilot = await connect_vehicle(config)
    try:
        left_to_do = ""
        if install_dead_man:
            await autopilot.claim(resumes=False)
            left_to_do = await autopilot.dead_man.install()
        unfit, settings = await _inspected(autopilot)
        return VehicleSurvey(
            vehicle=str(autopilot.vehicle.found_vehicle),
            version=str(autopilot.vehicle.version or ""),
            unfit=unfit,
            settings=settings,
            dead_man_lacks=left_to_do or await autopilot.dead_man.missing(),
        )
    finally:
        await autopilot.close()


async def _inspected(autopilot: MavlinkAutopilot) -> tuple[str, list[VehicleSetting]]:
    """Why the vehicle cannot be flown, if so, and the parameters that a person should know of."""
    settings: list[VehicleSetting] = []

    def hear(news: VehicleNews) -> None:
        if isinstance(news, VehicleSetting):
            settings.append(news)

    autopilot.listen(hear)
    try:
        await autopilot.inspect()
        await autopilot.learn()
        await autopilot.vehicle.look_for_others("check")
    except AutopilotRefused as error:
        return error.problem, settings
    return "", settings


async def survey_networks(config: DroneConfig) -> list[SurveyFinding]:
    """What NetworkManager has ready for the drone; raises NetworkError without one."""
    with extra("network"):
        from upwash.real.network.profiles import survey_networks
    return await survey_networks(
        config.network.interfaces,
        {server.name: server.network for server in config.servers},
        radios=config.network.radios,
    )


@dataclass(frozen=True, slots=True)
class _Wanted:
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
    """Whether each server can be used: its network is joined, and the drone's services are started and called.

    Calls have a photo of the drone's camera, if the service takes photos. Raises CredentialsError for an invalid
    certificate of the drone, and NetworkError if no network can be joined at all.
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
    try:
        seen = await look(config)
    except UpwashError as error:
        return Look({}), [SurveyFinding("camera", "gives no photo", str(error))]
    return seen, [
        SurveyFinding("camera", f"gives {', '.join(seen.photos) or 'nothing'}", trouble)
        for trouble in seen.troubles
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
        await session.ask()
        running = session.running
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
    """The time of the first call of each operation, as text; raises UpwashError for a call that fails or is late."""
    said: dict[str, str] = {}
    for sample, photo, request in requests_of(found):
        took_s = await _call(session, wanted, sample, photo, request)
        said.setdefault(str(sample.operation), f", called {sample.operation} in {took_s:.2f} s")
        local_s = wanted.estimates.alone_s(sample.operation)
        remote_s = wanted.estimates.remote_s(server.name, sample.operation)
        if local_s is None or remote_s is None:
            continue
        waits_s = Deadline().seconds(local_s=local_s, remote_s=remote_s)
        if took_s > waits_s and (again_s := await _call(session, wanted, sample, photo, request)) > waits_s:
            profile = ("upwash", "profile", sample.operation.service, "--config", "CONFIG")
            raise UpwashError(
                f"{sample.operation} takes {again_s:.2f} s there, and a flight waits {waits_s:.2f} s for it: measure "
                f"it with {command(*profile, '--server', server.name, '--photos', 'DIR')}"
            )
    if not found:
        try:
            await session.probe()
        except Unreachable as error:
            raise Unreachable(f"{error}: {_OTHER_PORTS}") from error
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
    answer_of(sample, photo, reply)
    return took_s


def trials(spec: ServiceSpec, estimates: Estimates, photos: Mapping[str, bytes]) -> list[CallSample]:
    """The operations that a flight may call, each with these photos; empty for a service that takes no photo."""
    if not photos:
        return []
    try:
        found = samples(spec, photos)
    except UsageError:
        return []
    return [sample for sample in found if estimates.alone_s(sample.operation) is not None]


def call_limit_s(local_s: float | None) -> float:
    """The time limit for a trial of an operation that takes `local_s` on the drone."""
    return max(_LEAST_CALL_S, 10 * (local_s or 0.0))


async def services_in_trouble(
    config: DroneConfig, photos: Mapping[str, bytes], tell: Callable[[str], None] = lambda _: None
) -> list[UpwashError]:
    """Why some of the drone's own services cannot be used: each is started, called with the photos, and ended.

    `tell` gets a line for each operation that finds boxes in photos.
    """
    services = load_services(config.services)
    estimates = make_estimates(config, {name: spec_of(service.cls) for name, service in services.items()})
    own, failed = OwnProcesses(config.name, max_message_bytes=config.max_message_bytes), list[UpwashError]()
    for name, service in services.items():
        if not spec_of(service.cls).on_drone:
            continue
        spec = InstanceSpec(config.name, name, service.program)
        found = trials(spec_of(service.cls), estimates, photos)
        try:
            answers = await _try_out(config, own, spec, found, estimates=estimates)
        except UpwashError as error:
            failed.append(error)
            continue
        for operation, given in answers.items():
            if line := told_boxes(operation, given, as_chance=False):
                tell(line)
    return failed


async def _try_out(
    config: DroneConfig,
    own: OwnProcesses,
    spec: InstanceSpec,
    found: list[CallSample],
    *,
    estimates: Estimates,
) -> dict[str, list[object]]:
    """The answers of each operation to the photos."""
    answers: dict[str, list[object]] = {}
    instance = await started(own, spec, within_s=config.start_timeout_s)
    try:
        await instance.admit(frozenset({config.name}))
        link = own.dial(instance.endpoint, server=ON_DRONE)
        try:
            for sample, photo, request in requests_of(found):
                path = service_path(sample.operation.service, sample.operation.method)
                limit_s = call_limit_s(estimates.local_s(sample.operation))
                reply = await link.request(path, request, timeout_s=limit_s)
                answers.setdefault(str(sample.operation), []).append(answer_of(sample, photo, reply))
        finally:
            await link.close()
    finally:
        await instance.stop()
    return answers


def requests_of(found: list[CallSample]) -> Iterator[tuple[CallSample, str, bytes]]:
    """Each request, with its operation and the name of its photo."""
    for sample in found:
        for photo, request in sample.requests.items():
            yield sample, photo, request
