"""A container of Docker or Podman: its limits, what it sees, and how its service gets its sockets."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import signal
import socket
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import msgspec

from upwash.core.admission.limits import DEFAULT_LIMITS, Limits
from upwash.errors import EngineError, InstanceError
from upwash.ports import Handed, InstanceSpec
from upwash.real.instances.containers import ServiceImage, container_name
from upwash.real.instances.docker.engine import DockerEngine, last_line
from upwash.real.instances.docker.inside import COMMAND, HANDOFF
from upwash.real.instances.local_instance import STOP_GRACE_S
from upwash.real.instances.runtime import exit_code
from upwash.support.background import begin, first

_log = logging.getLogger("upwash.docker")

SERVER = "upwash.server"  # the label by which a daemon finds its containers
_USER = "1000:1000"
_LOG_SIZE = "64k"  # of output before the service has its sockets
_FIRST_KILLED = 1000  # when the machine runs out of memory, as services in a sandbox
_TAKES_OVER_S = 20.0
_LOOK_S = 0.5
_ENDS_S = 5.0
_LONGEST_CODE = 8  # bytes: a hostile service might write there too
_NANO = 10**9
_labels = msgspec.json.Decoder(dict[str, str])


@dataclass(frozen=True, slots=True)
class DockerSettings:
    """What every container of a daemon may use.

    Sockets are handed over below the `folder`, which no other user may enter.
    """

    folder: Path
    limits: Mapping[str, Limits] = field(default_factory=dict)  # by service
    devices: Mapping[str, Sequence[str]] = field(default_factory=dict)  # by service: paths, or names


def definition(
    image: ServiceImage, settings: DockerSettings, *, server: str, command: Sequence[str], folder: Path | None
) -> dict[str, object]:
    """A container's definition: no network, no rights, and only memory to write to.

    The folder has the socket over which the daemon hands over the service's own. It is mounted where
    `upwash.real.instances.docker.inside` expects it.
    """
    binds = [f"{folder}:{Path(HANDOFF).parent}:ro"] if folder else []
    if image.base == "host":
        binds.append("/usr:/usr:ro")
    limits = settings.limits.get(image.service, DEFAULT_LIMITS)
    scratch = f"size={limits.disk_bytes},mode=1777,nosuid,nodev"
    devices = settings.devices.get(image.service, ())
    paths = [device for device in devices if device.startswith("/")]
    named = [device for device in devices if not device.startswith("/")]
    return {
        "image": image.fingerprint,
        "name": container_name(image.service, server),
        "entrypoint": list(command),
        "command": [],
        "user": _USER,
        "working_dir": "/tmp",  # noqa: S108 - its own
        "environment": {"HOME": "/tmp"},  # noqa: S108 - its own
        "labels": {SERVER: server},
        "host_config": {
            "network_mode": "none",
            "read_only": True,
            "cap_drop": ["ALL"],
            "security_opt": ["no-new-privileges"],
            "ipc_mode": "private",
            "mem_limit": limits.memory_bytes,
            "memswap_limit": limits.memory_bytes,  # no swap besides
            "pids_limit": limits.processes,
            "nano_cpus": limits.cpus * _NANO if limits.cpus else None,
            "oom_score_adj": _FIRST_KILLED,
            "log_config": {"Type": "json-file", "Config": {"max-size": _LOG_SIZE}},
            "binds": binds,
            "tmpfs": {"/tmp": scratch, "/var/tmp": scratch},  # noqa: S108 - its own
            "shm_size": limits.disk_bytes,
            "devices": [f"{path}:{path}:rw" for path in paths],
            "device_requests": [{"Driver": "cdi", "DeviceIDs": named}] if named else None,
        },
    }


class DockerContainer:
    """A running container whose service has its sockets."""

    def __init__(self, engine: DockerEngine, name: str, line: socket.socket) -> None:
        self._engine = engine
        self._name = name
        self._line = line
        self._is_paused = False
        self._ended = begin(self._await_end())

    async def ended(self) -> int:
        """The exit code of the container's service once that has ended; negative for a signal."""
        return await asyncio.shield(self._ended)

    async def end(self) -> None:
        """Ask the service to end, then remove the container; without its daemon a container ends by itself."""
        with contextlib.suppress(EngineError):  # it has ended meanwhile
            if not self._is_paused and not self._ended.done():
                await self._engine.ask(lambda api: api.kill(self._name, "SIGTERM"))
                await asyncio.wait([self._ended], timeout=STOP_GRACE_S)
        try:
            await self._engine.remove(self._name)
        except EngineError as error:
            _log.warning("container %s could not be removed: %s", self._name, error)
        self._line.close()

    async def pause(self) -> None:
        """Freeze all processes in the container."""
        await self._engine.ask(lambda api: api.pause(self._name))
        self._is_paused = True

    async def unpause(self) -> None:
        """Let a frozen container go on."""
        await self._engine.ask(lambda api: api.unpause(self._name))
        self._is_paused = False

    async def _await_end(self) -> int:
        """The exit code that process 1 reports; the engine's, if process 1 could not report one."""
        loop, report = asyncio.get_running_loop(), b""
        with contextlib.suppress(OSError):
            while len(report) <= _LONGEST_CODE and (chunk := await loop.sock_recv(self._line, _LONGEST_CODE)):
                report += chunk
        if re.fullmatch(rb"-?\d{1,3}\n", report):
            return int(report)
        with contextlib.suppress(EngineError):
            return exit_code(await self._engine.wait(self._name, wait_s=_ENDS_S))
        return -signal.SIGKILL


async def run(
    engine: DockerEngine, image: ServiceImage, settings: DockerSettings, spec: InstanceSpec, handed: Handed
) -> DockerContainer:
    """A new container with a service on these sockets; raises EngineError, and leaves nothing behind then."""
    with (
        tempfile.TemporaryDirectory(prefix="c-", dir=settings.folder) as folder,  # what is mounted remains
        _handoff(Path(folder)) as door,
    ):
        made = definition(image, settings, server=spec.server, command=COMMAND, folder=Path(folder))
        name = await engine.create(made)
        try:
            await engine.ask(lambda api: api.start(name))
            line = await _taken_over(engine, name, door, spec)
        except BaseException:
            await engine.remove(name)
            raise
    assert handed.outside is not None  # noqa: S101 - a container has nowhere to listen itself
    sockets = [handed.control.fileno(), handed.output.fileno(), handed.outside.fileno()]
    socket.send_fds(line, [b"!"], sockets)
    return DockerContainer(engine, name, line)


def _handoff(folder: Path) -> socket.socket:
    """The socket at which a container asks for those of its service.

    The container's user may enter this folder; other users of this machine cannot enter the folder above it.
    """
    door = socket.socket(socket.AF_UNIX)
    path = folder / Path(HANDOFF).name
    door.bind(str(path))
    folder.chmod(0o755)
    path.chmod(0o666)
    door.listen(1)
    door.setblocking(False)
    return door


async def describe(
    engine: DockerEngine, image: ServiceImage, settings: DockerSettings, *, server: str
) -> Mapping[str, str]:
    """The labels that the image's program prints, run alone in a container; raises EngineError."""
    name = await engine.create(
        definition(image, settings, server=server, command=(*COMMAND, image.program.path), folder=None)
    )
    try:
        await engine.ask(lambda api: api.start(name))
        code = await engine.wait(name, wait_s=_TAKES_OVER_S)
        output, errors = await engine.output(name)
    finally:
        await engine.remove(name)
    try:
        if code != 0:
            raise ValueError(last_line(output, errors))
        return _labels.decode(last_line(output))
    except (ValueError, msgspec.MsgspecError) as error:
        raise EngineError(
            f"the image of {image.service} does not say what {image.program.path} declares: {error}; it needs "
            "python3 with upwash, and the program that its label upwash.program names"
        ) from error


async def _taken_over(
    engine: DockerEngine, name: str, door: socket.socket, spec: InstanceSpec
) -> socket.socket:
    try:
        async with asyncio.timeout(_TAKES_OVER_S):
            line, _ = await first(
                asyncio.get_running_loop().sock_accept(door), _require_running(engine, name, spec)
            )
            return line
    except TimeoutError:
        raise EngineError(
            f"{spec.name} did not start: its container runs, but asked for nothing within {_TAKES_OVER_S:.0f} s; "
            "does the engine run on this machine, and may its containers use a socket that is mounted?"
        ) from None


async def _require_running(engine: DockerEngine, name: str, spec: InstanceSpec) -> NoReturn:
    while (await engine.ask(lambda api: api.inspect_container(name)))["State"].get("Running"):  # noqa: ASYNC110
        await asyncio.sleep(_LOOK_S)
    raise InstanceError(f"{spec.name} did not start: {last_line(*await engine.output(name))}")
