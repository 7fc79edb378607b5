"""Makes the calls of a flight before it: each operation that it may call, with a photo of its camera."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from upwash.config import DroneConfig
from upwash.core.knowledge.estimates import Estimates
from upwash.core.operation import ON_DRONE
from upwash.drone.onboard import started
from upwash.drone.preparation import make_estimates
from upwash.errors import UpwashError, UsageError
from upwash.launch.drone import onboard
from upwash.missions.bundled import load_services
from upwash.ports import InstanceSpec
from upwash.profiling.profiler import CallSample, require_answer, samples
from upwash.real.instances.runtime import OwnProcesses
from upwash.rpc.protocol import service_path
from upwash.rpc.service import ServiceSpec, spec_of

_LEAST_CALL_S = 60.0  # the first call after a start may have much to load


def trials(spec: ServiceSpec, estimates: Estimates, photos: Mapping[str, bytes]) -> list[CallSample]:
    """The operations that a flight may call, each with these photos; none for a service that takes no photo."""
    if not photos:
        return []
    try:
        found = samples(spec, photos)
    except UsageError:
        return []
    return [each for each in found if estimates.local_s(each.operation) is not None]


def call_limit_s(local_s: float | None) -> float:
    """How long a trial of an operation may take that takes so long on the drone."""
    return max(_LEAST_CALL_S, 10 * (local_s or 0.0))


async def services_in_trouble(config: DroneConfig, photos: Mapping[str, bytes]) -> list[UpwashError]:
    """Starts each of the drone's own services, calls it with the photos, and ends it; why some cannot be used."""
    services = load_services(config.services)
    estimates = make_estimates(config, {name: spec_of(each.cls) for name, each in services.items()})
    own, failed = onboard(config.name, max_message_bytes=config.max_message_bytes), list[UpwashError]()
    for name, service in services.items():
        spec = InstanceSpec(config.name, name, service.program)
        found = trials(spec_of(service.cls), estimates, photos)
        try:
            await _try_out(config, own, spec, found, estimates=estimates)
        except UpwashError as error:
            failed.append(error)
    return failed


async def _try_out(
    config: DroneConfig,
    own: OwnProcesses,
    spec: InstanceSpec,
    found: list[CallSample],
    *,
    estimates: Estimates,
) -> None:
    instance = await started(own, spec, within_s=config.start_timeout_s)
    try:
        await instance.admit(frozenset({config.name}))
        link = own.dial(instance.endpoint, server=ON_DRONE)
        try:
            for sample, photo, request in requests_of(found):
                path = service_path(sample.operation.service, sample.operation.method)
                limit_s = call_limit_s(estimates.local_s(sample.operation))
                require_answer(sample, photo, await link.request(path, request, timeout_s=limit_s))
        finally:
            await link.close()
    finally:
        await instance.stop()


def requests_of(found: list[CallSample]) -> Iterator[tuple[CallSample, str, bytes]]:
    """Each request, with its operation and the name of its photo."""
    for sample in found:
        for photo, request in sample.requests.items():
            yield sample, photo, request
