"""Measures what a service's calls cost, before the flight: here, or at one of the drone's servers."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from upwash.config.drone import DroneConfig, ServerConfig
from upwash.config.values import MDNS
from upwash.drone.networks import NoNetwork
from upwash.drone.server_session import ServerEndpoint
from upwash.launch.drone import (
    drone_credentials,
    require_address,
    require_certificates,
    server_dialer,
    server_finder,
)
from upwash.missions.bundled import LoadedService
from upwash.ports import InstanceSpec
from upwash.profiling.agreement import LabelledBox
from upwash.profiling.profiler import (
    CallSample,
    OnboardProfile,
    PartProfile,
    ServerProfile,
    Watch,
    profile_onboard,
    profile_part,
    profile_server,
)
from upwash.real.instances.runtime import OwnProcesses
from upwash.rpc.service import spec_of

_PROFILER = "profiler"
_MAX_MESSAGE_BYTES = 16 * 2**20
_PEAK_KB = re.compile(r"^VmHWM:\s*(\d+) kB", re.MULTILINE)


async def profile_on_this_computer(
    service: LoadedService, found: Sequence[CallSample], *, calls: int, start_timeout_s: float, watch: Watch
) -> OnboardProfile:
    """Measures the service in instances such as the drone's own."""
    own = OwnProcesses(_PROFILER, max_message_bytes=_MAX_MESSAGE_BYTES)
    return await profile_onboard(
        InstanceSpec(_PROFILER, spec_of(service.cls).name, service.program),
        found,
        calls=calls,
        drone=_PROFILER,
        start_timeout_s=start_timeout_s,
        runtime=own,
        dialer=own,
        memory_bytes=_peak_memory_bytes,
        watch=watch,
    )


async def profile_part_on_this_computer(
    service: LoadedService,
    found: Sequence[CallSample],
    *,
    labels: Mapping[str, Sequence[LabelledBox]] | None,
    start_timeout_s: float,
) -> PartProfile:
    """Measures the part of the service before sending, as the drone runs it."""
    own, spec = OwnProcesses(_PROFILER, max_message_bytes=_MAX_MESSAGE_BYTES), spec_of(service.cls)
    assert service.part is not None and spec.before_sending is not None  # noqa: S101 - the caller has looked
    return await profile_part(
        InstanceSpec(_PROFILER, spec_of(spec.before_sending).name, service.part, before=spec.name),
        InstanceSpec(_PROFILER, spec.name, service.program),
        found,
        labels=labels,
        drone=_PROFILER,
        start_timeout_s=start_timeout_s,
        runtime=own,
        dialer=own,
    )


async def profile_at(
    server: ServerConfig, config: DroneConfig, found: Sequence[CallSample], *, calls: int, watch: Watch
) -> ServerProfile:
    """Measures a service at one of the drone's servers, with the drone's certificate."""
    require_address(server)
    require_certificates(server, config)
    dialer = server_dialer(config, drone_credentials(config))
    services = tuple(dict.fromkeys(sample.operation.service for sample in found))
    finder = server_finder(config) if server.address == MDNS else None
    endpoint = ServerEndpoint(server.name, server.network, server.address or "", services, finder)
    return await profile_server(
        endpoint,
        found,
        calls=calls,
        start_timeout_s=config.start_timeout_s,
        network=NoNetwork(),
        dialer=dialer,
        watch=watch,
    )


def _peak_memory_bytes() -> int:
    """The sum of the peak memory of each running process that this process started, and of theirs."""
    statuses = (_read(Path(f"/proc/{process}/status")) for process in _descendants(os.getpid()))
    return 1024 * sum(int(peak) for status in statuses for peak in _PEAK_KB.findall(status))


def _descendants(process: int) -> Iterator[int]:
    for thread in Path(f"/proc/{process}/task").glob("*"):
        for child in _read(thread / "children").split():
            yield int(child)
            yield from _descendants(int(child))


def _read(file: Path) -> str:
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has ended
        return file.read_text()
    return ""
