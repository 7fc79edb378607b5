"""The sandbox of a service instance: bubblewrap's arguments. An instance sets its `limits` on itself.

In a sandbox there is no network except the inherited socket. Files of the system, Python and the service are there,
read-only, and a /tmp of its own in memory. There are no devices except those that the operator names, no processes
except the instance's, and the kernel's calls that `syscalls` allows. With a graphics card there is what CUDA needs.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from importlib.machinery import PathFinder
from pathlib import Path

from upwash.errors import UsageError
from upwash.ports import Program
from upwash.real.instances.cards import has_card, read_by_cuda
from upwash.real.instances.syscalls import call_filter
from upwash.support.input_files import with_data
from upwash.support.loading import module_command

_PROBE_S = 10.0
_PATHS = re.compile(r"'(/[^'\n]+)'|\"(/[^\"\n]+)\"|(?<![\w/.:'\"])(/[^\s'\"(),:;]+)")
_RELATIVE = re.compile(r"No such file or directory: '([^/'\n][^'\n]*)'")
_MODULES = re.compile(r"No module named '(\w+)")
_MOST_NAMES = 3
_TASKSET = "taskset"
# For limits that were tried in the sandbox and do not hold there.
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
# Below /proc, where root always has rights: the machine's keys, log, memory and devices.
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
# When the machine runs out of memory, the kernel kills these processes first. They inherit no environment.
_LAUNCHER = ("/bin/sh", "-c", 'echo 1000 >/proc/self/oom_score_adj; exec /usr/bin/env -i "$@"', "sh")
_ENVIRONMENT = ("LANG", "LC_ALL", "TZ", "GRPC_VERBOSITY", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
# Of NumPy and OpenCV, each with an OpenBLAS of its own, which reserves 40 and 136 MB for a thread of each processor:
# with 16 processors more than `memory_bytes`.
_BLAS_THREADS = "4"


@dataclass(frozen=True, slots=True)
class Sandbox:
    """Wraps commands for bubblewrap, so that they can read these files.

    `unenforced` has the reason for each limit that does not hold.
    """

    bubblewrap: str
    readable: tuple[Path, ...] = ()
    unenforced: Mapping[str, str] = field(default_factory=dict)

    def wrap(
        self,
        command: Iterable[str],
        *,
        call_filter: int,
        program: Program | None = None,
        devices: Collection[str] = (),
        disk_bytes: int | None = None,
        processors: Collection[int] = (),
    ) -> list[str]:
        """The command in a sandbox that can read Python, upwash, the program's code and its settings' files.

        It inherits the file descriptor `call_filter` of `open_call_filter`. Each folder that it may write to holds
        `disk_bytes`. It may use these `devices`. It runs on these `processors`, on all if there are none.
        """
        shown_by_kernel = (*_SETTINGS, *(read_by_cuda() if has_card(devices) else ()))
        size = () if disk_bytes is None else ("--size", str(disk_bytes))
        pinned = ("--cpu-list", ",".join(map(str, sorted(processors))))
        return [
            *_LAUNCHER,
            *((shutil.which(_TASKSET) or _TASKSET, *pinned) if processors else ()),
            *(self.bubblewrap, "--seccomp", str(call_filter)),
            *("--unshare-all", "--unshare-user", "--die-with-parent", "--new-session", "--cap-drop", "ALL"),
            *(word for name in _SYSTEM for word in _as_it_is(name)),
            *(word for name in shown_by_kernel for word in ("--ro-bind-try", name, name)),
            *("--proc", "/proc", *_hidden_in_proc(), *_read_only_proc(devices), "--dev", "/dev"),
            *("--dev-bind", "/dev/full", "/dev/zero"),  # it reads the same, but cannot be mapped
            *(word for device in devices for word in ("--dev-bind", device, device)),
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

    def remedy(self, reason: str, program: Program) -> str:
        """What to add to the reason of a failed start; empty if it names nothing that the sandbox hides.

        It does not reveal whether a hidden file exists.
        """
        if relative := _RELATIVE.search(reason):
            return (
                f"; in a sandbox relative paths begin at its own /tmp: have the service use the whole path of "
                f"{relative[1]}, and name that in runtime.readable"
            )
        shown = [*self._shown(program), *map(Path, (*_SYSTEM, *_SETTINGS, "/proc", "/dev"))]
        named = dict.fromkeys(_named(reason, Path(program.path.rpartition(":")[0]).resolve().parent))
        hidden = [name for name in named if not any(Path(name).is_relative_to(place) for place in shown)]
        if not hidden:
            return ""
        names = ", ".join(hidden[:_MOST_NAMES])
        return f"; the sandbox hides {names}: name what the service needs in runtime.readable"

    def _shown(self, program: Program | None) -> list[Path]:
        """The files and folders that can be read besides the system's."""
        shown = [Path(sys.prefix), Path(sys.base_prefix), Path(__file__).parents[2], *self.readable]
        if program is not None:
            shown += [*code_of(program.path), *files_in(program.settings), *files_in(program.command)]
        return shown


def find_sandbox(*, readable: tuple[Path, ...]) -> Sandbox:
    """A sandbox that was tested here, with its limits; raises UsageError with the remedy if none works."""
    bubblewrap = shutil.which("bwrap")
    if bubblewrap is None:
        raise UsageError("bubblewrap is not installed: `apt install bubblewrap`")
    sandbox = Sandbox(bubblewrap, readable)
    can_pin = shutil.which(_TASKSET) is not None
    processors = sorted(os.sched_getaffinity(0))[:1] if can_pin else []
    try:
        with open_call_filter(pins=can_pin) as inherited:
            tried = subprocess.run(  # noqa: S603 - bubblewrap itself
                sandbox.wrap(
                    module_command("upwash.real.instances.limits"),
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
def open_call_filter(*, pins: bool = False, devices: Collection[str] = ()) -> Iterator[int]:
    """A file descriptor with the filter of system calls for one bubblewrap; raises UsageError.

    With `pins` a process cannot choose other processors. With a card among the `devices` it can share memory.
    """
    text = call_filter(pins=pins, shares=has_card(devices))
    reading, writing = os.pipe()
    try:
        with open(writing, "wb", buffering=0) as pipe:  # noqa: PTH123 - a file descriptor
            pipe.write(text)  # far less than a pipe holds
        yield reading
    finally:
        os.close(reading)


def code_of(program: str) -> list[Path]:
    """The file or folder of a program's code, found without running it; empty if it cannot be found."""
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
    """The existing files and folders whose absolute paths stand in a program's settings, with their data."""
    match settings:
        case str() if settings.startswith("/") and Path(settings).exists():
            return with_data(Path(settings))
        case Mapping():
            return [file for value in settings.values() for file in files_in(value)]
        case list() | tuple():
            return [file for value in settings for file in files_in(value)]
        case _:
            return []


def _named(reason: str, folder: Path) -> Iterator[str]:
    """The absolute paths in a text, and the paths of modules that are missing according to it.

    The `folder` of the service's program is searched first for modules.
    """
    for found in _PATHS.finditer(reason):
        yield found[found.lastindex or 0]
    for found in _MODULES.finditer(reason):
        spec = PathFinder.find_spec(found[1], [str(folder), *sys.path])
        if spec is not None:
            places = spec.submodule_search_locations or [spec.origin or ""]
            yield from (place for place in places if place.startswith("/"))


def _hidden_in_proc() -> Iterator[str]:
    for place in (Path("/proc", name) for name in _HIDDEN):
        if place.is_dir():
            yield from ("--tmpfs", str(place), "--remount-ro", str(place))
        elif place.exists():
            yield from ("--ro-bind", "/dev/null", str(place))


def _read_only_proc(devices: Collection[str]) -> Iterable[str]:
    """CUDA names its threads there, in files that are their process's own; root could write others too."""
    return () if has_card(devices) and os.geteuid() != 0 else ("--remount-ro", "/proc")


def _as_it_is(name: str) -> Iterator[str]:
    path = Path(name)
    if path.is_symlink():  # /lib is usr/lib on merged systems
        yield from ("--symlink", str(path.readlink()), name)
    elif path.exists():
        yield from ("--ro-bind", name, name)


def _outermost(paths: Iterable[Path]) -> list[Path]:
    """The paths that exist, and lie neither below another path nor in the system."""
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
        "OPENBLAS_NUM_THREADS": _BLAS_THREADS,
        **kept,
    }
