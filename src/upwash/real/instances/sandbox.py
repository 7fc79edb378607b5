"""What a service instance may see: bubblewrap's arguments. What it may use, it puts on itself: see `limits`.

In a sandbox there is no network but the socket that the instance inherits, no file but the system's, Python's and the
service's own, all read-only, a /tmp of its own in memory, no device but those that the operator names, no process but
the instance's, and of the kernel what `syscalls` lets through.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from upwash.errors import UsageError
from upwash.ports import Program
from upwash.real.instances.hidden import sandbox_remedy
from upwash.real.instances.syscalls import call_filter
from upwash.support.loading import module_command

_PROBE_S = 10.0
_TASKSET = "taskset"
# Of a limit that was tried in the sandbox and does not hold there.
_KERNEL = 'the kernel does not enforce it: use another kernel, or runtime.kind = "docker" or "lxd"'
_REMEDIES = {
    "memory_bytes": _KERNEL,
    "processes": "Linux does not limit the processes of root: run the daemon as a user of its own",
    "disk_bytes": _KERNEL,
    "cpus": f"{_TASKSET} is not installed: `apt install util-linux`",
}
_SYSTEM = ("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32")
_SETTINGS = (
    "/etc/alternatives",
    "/etc/fonts",
    "/etc/ld.so.cache",
    "/etc/ld.so.conf",
    "/etc/ld.so.conf.d",
    "/etc/localtime",
    "/sys/devices/system/cpu",  # by which numerical libraries count their threads
)
# Of /proc, in which root is never without rights: the machine's keys, log, memory and devices.
_HIDDEN = (
    "acpi",
    "asound",
    "bus",
    "config.gz",
    "fs",
    "irq",
    "kallsyms",
    "kcore",
    "key-users",
    "keys",
    "kmsg",
    "latency_stats",
    "mtrr",
    "sched_debug",
    "scsi",
    "slabinfo",
    "sysrq-trigger",
    "timer_list",
    "vmallocinfo",
)
# Sets what only a process can set for itself, and leaves nothing of the daemon's environment in any process inside.
# When the machine runs out of memory, these processes are the first to be killed.
_LAUNCHER = ("/bin/sh", "-c", 'echo 1000 >/proc/self/oom_score_adj; exec /usr/bin/env -i "$@"', "sh")
_ENVIRONMENT = ("LANG", "LC_ALL", "TZ", "GRPC_VERBOSITY", "OMP_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Sandbox:
    """Wraps commands so that they run by bubblewrap, where these files can be read, and these devices used.

    `unenforced` says why a limit of that name does not hold in it.
    """

    bubblewrap: str
    readable: tuple[Path, ...] = ()
    devices: tuple[str, ...] = ()
    unenforced: Mapping[str, str] = field(default_factory=dict)

    def wrap(
        self,
        command: Iterable[str],
        *,
        call_filter: int,
        program: Program | None = None,
        disk_bytes: int | None = None,
        processors: Collection[int] = (),
    ) -> list[str]:
        """The command in a sandbox where Python, upwash, the program's code and its settings' files can be read.

        `call_filter` is a file descriptor of `open_call_filter` that it inherits. Each folder for files that it
        writes holds `disk_bytes`. It runs on these `processors`, all if none are given.
        """
        size = () if disk_bytes is None else ("--size", str(disk_bytes))
        return [
            *(*_LAUNCHER, *_on(processors), self.bubblewrap, "--seccomp", str(call_filter)),
            *("--unshare-all", "--unshare-user", "--die-with-parent", "--new-session", "--cap-drop", "ALL"),
            *(word for name in _SYSTEM for word in _as_it_is(name)),
            *(word for name in _SETTINGS for word in ("--ro-bind-try", name, name)),
            *("--proc", "/proc", *_hidden_in_proc(), "--remount-ro", "/proc", "--dev", "/dev"),
            *("--dev-bind", "/dev/full", "/dev/zero"),  # which reads the same, but cannot be mapped
            *(word for device in self.devices for word in ("--dev-bind", device, device)),
            *(*size, "--tmpfs", "/dev/shm"),  # noqa: S108 - its own
            *("--remount-ro", "/dev", *size, "--tmpfs", "/tmp"),  # noqa: S108 - its own
            *(
                word
                for path in _outermost(self._shown(program))
                for word in ("--ro-bind", str(path), str(path))
            ),
            *("--remount-ro", "/", "--chdir", "/tmp"),  # noqa: S108 - its own
            *(word for name, value in _environment().items() for word in ("--setenv", name, value)),
            "--",
            *command,
        ]

    def remedy(self, said: str, program: Program) -> str:
        """What to add to the words of a failed start of the program; empty where they name nothing hidden."""
        shown = [*self._shown(program), *map(Path, (*_SYSTEM, *_SETTINGS, "/proc", "/dev"))]
        return sandbox_remedy(
            said,
            folder=Path(program.path.rpartition(":")[0]).resolve().parent,
            is_shown=lambda path: any(path.is_relative_to(each) for each in shown),
        )

    def _shown(self, program: Program | None) -> list[Path]:
        """The files and folders that are shown besides the system's."""
        own = _files_of(program) if program else []
        return [Path(sys.prefix), Path(sys.base_prefix), Path(__file__).parents[2], *self.readable, *own]


def find_sandbox(*, readable: tuple[Path, ...], devices: tuple[str, ...] = ()) -> Sandbox:
    """A sandbox that was tried, and its limits too; raises UsageError with the remedy where this machine has none."""
    bubblewrap = shutil.which("bwrap")
    if bubblewrap is None:
        raise UsageError("bubblewrap is not installed: `apt install bubblewrap`")
    sandbox = Sandbox(bubblewrap, readable, devices)
    can_pin = shutil.which(_TASKSET) is not None
    processors = sorted(os.sched_getaffinity(0))[:1] if can_pin else []
    try:
        with open_call_filter(pins=can_pin) as inherited:
            tried = subprocess.run(  # noqa: S603 - bubblewrap itself
                sandbox.wrap(
                    module_command("upwash.real.instances.limits_trial"),
                    call_filter=inherited,
                    processors=processors,
                ),
                capture_output=True,
                timeout=_PROBE_S,
                check=False,
                pass_fds=(inherited,),
            )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UsageError(f"{bubblewrap} cannot be run: {error}") from error
    if tried.returncode != 0:
        said = tried.stderr.decode(errors="replace").strip()
        raise UsageError(
            f"bubblewrap may not make a sandbox here ({said}): allow user namespaces "
            "(sysctl user.max_user_namespaces, kernel.unprivileged_userns_clone, "
            "kernel.apparmor_restrict_unprivileged_userns), and hide nothing of /proc"
        )
    unenforced = {name: _REMEDIES[name] for name in json.loads(tried.stdout)}
    return replace(sandbox, unenforced=unenforced)


@contextlib.contextmanager
def open_call_filter(*, pins: bool = False) -> Iterator[int]:
    """A file descriptor from which one bubblewrap can read what to refuse; raises UsageError."""
    text = call_filter(pins=pins)
    reading, writing = os.pipe()
    try:
        with open(writing, "wb", buffering=0) as pipe:  # noqa: PTH123 - a file descriptor
            pipe.write(text)  # far less than a pipe holds
        yield reading
    finally:
        os.close(reading)


def _on(processors: Collection[int]) -> Iterator[str]:
    if processors:
        yield from (shutil.which(_TASKSET) or _TASKSET, "--cpu-list", ",".join(map(str, sorted(processors))))


def _files_of(program: Program) -> list[Path]:
    """Its code, and the files that its settings and its command name."""
    return [*code_of(program.path), *files_in(program.settings), *files_in(program.command)]


def code_of(program: str) -> list[Path]:
    """The file or folder in which a program's code lies; none where it cannot be found. Runs nothing of it."""
    place = program.rpartition(":")[0]
    if place.endswith(".py"):
        return [Path(place).resolve()]
    try:
        found = importlib.util.find_spec(place.partition(".")[0])
    except (ImportError, ValueError):
        return []
    if found is None:
        return []
    return [Path(place) for place in found.submodule_search_locations or [found.origin or ""]]


def files_in(settings: object) -> list[Path]:
    """The files and folders that are named by absolute paths somewhere in a program's settings, and exist."""
    match settings:
        case str() if settings.startswith("/") and Path(settings).exists():
            return [Path(settings)]
        case Mapping():
            return [file for value in settings.values() for file in files_in(value)]
        case list() | tuple():
            return [file for value in settings for file in files_in(value)]
        case _:
            return []


def _hidden_in_proc() -> Iterator[str]:
    for place in (Path("/proc", name) for name in _HIDDEN):
        if place.is_dir():
            yield from ("--tmpfs", str(place), "--remount-ro", str(place))
        elif place.exists():
            yield from ("--ro-bind", "/dev/null", str(place))


def _as_it_is(name: str) -> Iterator[str]:
    path = Path(name)
    if path.is_symlink():  # /lib is usr/lib on merged systems
        yield from ("--symlink", str(path.readlink()), name)
    elif path.exists():
        yield from ("--ro-bind", name, name)


def _outermost(paths: Iterable[Path]) -> list[Path]:
    """Those that exist, and lie neither in another of them nor in the system."""
    there = sorted({path for path in paths if path.exists()})
    return [
        path
        for path in there
        if not any(path != other and path.is_relative_to(other) for other in (*there, *map(Path, _SYSTEM)))
        and str(path) not in _SYSTEM
    ]


def _environment() -> Mapping[str, str]:
    kept = {name: os.environ[name] for name in _ENVIRONMENT if name in os.environ}
    return {
        "PATH": "/usr/bin:/bin",
        "HOME": "/tmp",  # noqa: S108 - its own
        "PYTHONPATH": os.pathsep.join(str(Path(place).resolve()) for place in sys.path if place),
        "PYTHONDONTWRITEBYTECODE": "1",
        **kept,
    }
