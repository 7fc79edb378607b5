"""Service instances as plain processes, each in a session of its own that is killed as a group."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import os
import signal
import subprocess
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from weakref import WeakSet, WeakValueDictionary

from upwash.errors import InstanceError, UpwashError
from upwash.ports import Answered, Engine, Handed, InstanceSpec, ServiceProcess, ignored
from upwash.real.instances.control import begin_of
from upwash.real.instances.instance_control import InstanceCallbacks, starting
from upwash.real.instances.local_instance import STOP_GRACE_S, LocalInstance
from upwash.real.instances.sandbox import Sandbox, open_call_filter
from upwash.real.link.direct import DirectLink
from upwash.real.link.door import Lead
from upwash.support.loading import module_command
from upwash.support.text import worded

_log = logging.getLogger("upwash.instance")
_KILL_S = 5.0  # for a killed process to be gone; a process that waits in the kernel may never be
_SIGNALLED = 128


def exit_code(code: int) -> int:
    """The exit code that a shell, bubblewrap or a container engine passed on, negative for a signal."""
    return _SIGNALLED - code if _SIGNALLED < code < _SIGNALLED + signal.NSIG else code


def sockets_in(folder: Path) -> Callable[[InstanceSpec], str]:
    """A unix socket in the folder for each instance."""
    numbers = itertools.count()
    return lambda spec: f"unix:{folder}/{spec.name}-{next(numbers)}.sock"


def nowhere(_spec: InstanceSpec) -> str:
    """No address: each instance is called over a socket pair."""
    return ""


class ProcessRuntime:
    """Runs each instance as a process that listens at `listen(spec)`, in the sandbox if there is one.

    If there is a `lead`, that address is a unix socket, and drones come through the door.
    """

    def __init__(
        self,
        listen: Callable[[InstanceSpec], str],
        *,
        max_message_bytes: int,
        lead: Lead | None = None,
        sandbox: Sandbox | None = None,
    ) -> None:
        self._listen = listen
        self._lead = lead
        self._max_message_bytes = max_message_bytes
        self._sandbox = sandbox
        self._is_apart = sandbox is not None  # each instance has files of its own
        self._groups: WeakSet[ProcessGroup] = WeakSet()

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = ignored
    ) -> LocalInstance:
        """An instance that is ready to serve; raises InstanceError, and leaves nothing behind then."""
        instance = LocalInstance(spec, self._run, InstanceCallbacks(called, answered, self._lead))
        begin = begin_of(
            spec,
            spec.program,
            listen=self._listen(spec),
            max_message_bytes=self._max_message_bytes,
            is_announced=self._lead is not None,
            limits=spec.limits if self._sandbox else None,
        )
        try:
            async with starting(instance):
                await instance.begin(begin, is_apart=self._is_apart)
        except InstanceError as error:
            if self._sandbox is None:
                raise
            raise InstanceError(f"{error}{self._sandbox.remedy(str(error), spec.program)}") from error
        return instance

    async def _run(self, spec: InstanceSpec, handed: Handed) -> ServiceProcess:
        inherited, command = _inherited(handed), _command(handed)
        processors = self._least_used(spec.limits.cpus)
        with contextlib.ExitStack() as stack:
            if self._sandbox is not None:
                inherited.append(
                    stack.enter_context(open_call_filter(pins=bool(processors), devices=spec.devices))
                )
                command = self._sandbox.wrap(
                    command,
                    call_filter=inherited[-1],
                    program=spec.program,
                    devices=spec.devices,
                    disk_bytes=spec.limits.disk_bytes,
                    processors=processors,
                )
            process = await asyncio.create_subprocess_exec(
                *command,
                stdin=subprocess.DEVNULL,
                stdout=handed.output.fileno(),
                stderr=handed.output.fileno(),
                pass_fds=inherited,
                start_new_session=True,
            )
        group = ProcessGroup(process, is_in_sandbox=self._sandbox is not None, processors=processors)
        self._groups.add(group)
        return group

    def _least_used(self, count: int | None) -> Sequence[int]:
        """The `count` processors to which the fewest instances are pinned; none without a limit."""
        if count is None:
            return ()
        used = Counter(number for group in self._groups if group.is_alive for number in group.processors)
        return sorted(os.sched_getaffinity(0), key=lambda number: (used[number], number))[:count]


def _inherited(handed: Handed) -> list[int]:
    return [end.fileno() for end in (handed.control, handed.outside) if end is not None]


def _command(handed: Handed) -> list[str]:
    """The command of an instance that inherits these descriptors."""
    return module_command("upwash.real.instances.instance", *map(str, _inherited(handed)))


class ProcessGroup:
    """A process and all that it started in its session, pinned to these `processors`."""

    def __init__(
        self, process: asyncio.subprocess.Process, *, is_in_sandbox: bool, processors: Sequence[int] = ()
    ) -> None:
        self.processors = processors
        self._process = process
        self._is_in_sandbox = is_in_sandbox

    @property
    def is_alive(self) -> bool:
        """Whether the process has not ended yet."""
        return self._process.returncode is None

    async def ended(self) -> int:
        """The process's exit code once it has ended; negative for a signal."""
        code = await self._process.wait()
        return exit_code(code) if self._is_in_sandbox else code

    async def end(self) -> None:
        """Terminate the process, then kill the group; returns when the process is gone."""
        self._signal(signal.SIGTERM)
        try:
            async with asyncio.timeout(STOP_GRACE_S):
                await self._process.wait()
        except TimeoutError:
            pass
        finally:
            self._signal(signal.SIGKILL)
        try:
            async with asyncio.timeout(_KILL_S):
                await self._process.wait()
        except TimeoutError:
            _log.error(
                "process %d goes on %.0f s after SIGKILL and is left behind: look at its state (D) and its driver",
                self._process.pid,
                _KILL_S,
            )

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, number)


class PlugInRuntime(ProcessRuntime):
    """Runs each instance in an engine that a plug-in brings; what its code raises is an InstanceError."""

    def __init__(
        self,
        engine: Engine,
        listen: Callable[[InstanceSpec], str],
        *,
        max_message_bytes: int,
        lead: Lead | None = None,
    ) -> None:
        super().__init__(listen, max_message_bytes=max_message_bytes, lead=lead)
        self._engine = engine
        self._is_apart = engine.is_apart

    async def _run(self, spec: InstanceSpec, handed: Handed) -> ServiceProcess:
        try:
            return await self._engine.run(spec, _command(handed), handed)
        except UpwashError:
            raise
        except Exception as error:
            raise InstanceError(f"{spec.name} did not start: its engine failed: {worded(error)}") from error


class OwnProcesses(ProcessRuntime):
    """Runs a program's own services, and dials them over socket pairs."""

    def __init__(self, drone: str, *, max_message_bytes: int) -> None:
        super().__init__(nowhere, max_message_bytes=max_message_bytes)
        self._drone = drone
        self._instances: WeakValueDictionary[str, LocalInstance] = WeakValueDictionary()

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = ignored
    ) -> LocalInstance:
        """An instance that is ready to serve; raises InstanceError, and leaves nothing behind then."""
        instance = await super().start(spec, called=called, answered=answered)
        self._instances[instance.endpoint] = instance
        return instance

    def dial(self, address: str, *, server: str) -> DirectLink:
        """The link to an instance that was started here, by its endpoint; only once."""
        return DirectLink(
            self._instances[address].take_calls(),
            peer=f"{server} at {address}",
            drone=self._drone,
            max_message_bytes=self._max_message_bytes,
        )
