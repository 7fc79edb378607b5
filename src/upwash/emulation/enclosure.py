"""Namespaces that isolate a program; no process in them outlives the program.

The program is the first process of a process namespace, with networks, mounts and temporary files that no other
process sees. When it ends, for any reason, the kernel kills its processes and removes its networks; when the command
that started it ends, it reads an end of file and ends too. Only control groups stay behind. They are made below a
group that is named after the command that owns the emulation, so that `clean` finds them.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from upwash.emulation.namespaces import command, require_tools
from upwash.errors import UsageError
from upwash.support.background import thread

MARK = "UPWASH_EMULATION"  # the environment variable with the owning command's process and start time
_TOOLS = {"unshare": "util-linux", "ip": "iproute2", "tc": "iproute2"}
_GONE_WITHIN_S = 5.0
_RETRY_S = 0.02
_STOP = b"stop\n"
_AHEAD_OF_OTHERS = -10  # the nice value: what is measured in real time should not wait for what is not


def require_root_and_tools() -> None:
    """Raises UsageError if emulations are not possible: without root, or without a tool."""
    if os.geteuid() != 0:
        raise UsageError("an emulation makes network namespaces: run it as root")
    require_tools(_TOOLS)


def run_enclosed(*arguments: str, handles: Sequence[int] = ()) -> int:
    """Runs `python ARGUMENTS` enclosed and returns its exit code; nothing that it started is left by then.

    The first SIGINT or SIGTERM asks the program to stop, the second kills it. It inherits the handles.
    """
    owner = _owner(os.getpid())
    process = subprocess.Popen(  # noqa: S603 - this very program
        [
            *("unshare", "--net", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc", "--"),
            *(sys.executable, *arguments),
        ],
        stdin=subprocess.PIPE,
        pass_fds=handles,
        env=os.environ | {MARK: owner},
        start_new_session=True,  # a Ctrl-C at the terminal is for this process alone, which passes it on
    )
    with _passed_on(process):
        try:
            return process.wait()
        finally:
            process.kill()
            process.wait()
            assert process.stdin is not None  # noqa: S101
            process.stdin.close()
            _remove_gone_groups(owner.__eq__)


@contextlib.contextmanager
def _passed_on(process: subprocess.Popen[bytes]) -> Iterator[None]:
    asked: list[int] = []

    def on_signal(number: int, _: object) -> None:
        if asked:
            process.kill()
            return
        asked.append(number)
        assert process.stdin is not None  # noqa: S101
        with contextlib.suppress(OSError):
            os.write(process.stdin.fileno(), _STOP)

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, on_signal) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def settle_in(stop: Callable[[], object]) -> None:
    """Prepares the enclosed program, which calls it first: own temporary files, and an end with the command's end.

    `stop` is called from a thread when the command asks the program to stop.
    """
    os.nice(_AHEAD_OF_OTHERS)
    command("mount", "-t", "tmpfs", "-o", "mode=755", "tmpfs", "/run")
    Path("/run/netns").mkdir()
    Path("/run/tmp").mkdir(mode=0o1777)
    os.environ["TMPDIR"] = "/run/tmp"
    command("ip", "link", "set", "lo", "up")
    thread(lambda: _listen(stop), name="control line", failed=lambda _: os._exit(1)).start()


def _listen(stop: Callable[[], object]) -> None:
    while said := os.read(0, 100):  # not by sys.stdin, whose lock would be held when the interpreter ends
        if _STOP in said:
            stop()
    os._exit(1)  # the first process of its namespace: all others die with it


def clean() -> int:
    """Kills the remaining processes of emulations whose command is gone; returns their number.

    Their namespaces and devices go with their processes. Other emulations, and everything else, are left alone.
    """
    killed: set[int] = set()
    deadline_s = time.monotonic() + _GONE_WITHIN_S
    while left := list(_orphans()):
        for process in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
            killed.add(process)
        if time.monotonic() > deadline_s:
            raise UsageError(f"these processes of a former emulation cannot be killed: {sorted(left)}")
        time.sleep(_RETRY_S)
    if busy := _remove_gone_groups(_is_gone):
        raise UsageError(f"these control groups of a former emulation cannot be removed: {busy}")
    return len(killed)


def _remove_gone_groups(is_gone: Callable[[str], bool]) -> list[Path]:
    """Remove groups as soon as their killed processes are gone; returns those that are left."""
    deadline_s = time.monotonic() + _GONE_WITHIN_S
    while (busy := remove_groups(is_gone)) and time.monotonic() < deadline_s:
        time.sleep(_RETRY_S)
    return busy


def _orphans() -> Iterator[int]:
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal() and (owner := _owner_of(entry)) is not None and _is_gone(owner):
            yield int(entry.name)


def _is_gone(owner: str) -> bool:
    return owner != _owner(int(owner.partition(":")[0]))


def _owner_of(process: Path) -> str | None:
    """The owner of an emulation's process; None for other processes."""
    with contextlib.suppress(OSError):
        prefix = f"{MARK}=".encode()
        for variable in (process / "environ").read_bytes().split(b"\0"):
            if variable.startswith(prefix):
                return variable.removeprefix(prefix).decode(errors="replace")
    return None


def _owner(pid: int) -> str:
    """A unique name of a process: its number and its start time."""
    try:
        started = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]
    except OSError:
        return ""
    return f"{pid}:{started}"


_ROOT = Path("/sys/fs/cgroup")
_PREFIX = "upwash-emulation-"
_OF_PROCESS_1 = "init.scope"  # where systemd keeps its own: engines make containers' groups beside it
_HANDED_DOWN = ("cpuset.cpus", "cpuset.mems")  # the first version of control groups does not do it
# Outside of the group its processes' nice values count for nothing: it gets what four of nice value -10 would.
_GROUP_WEIGHTS = {"cpu.shares": 40 * 1024, "cpu.weight": 40 * 100}


def enter_groups(owner: str) -> None:
    """Moves this process, the first of its namespace, into control groups of the owner, as for containers."""
    for hierarchy in _hierarchies():
        group = hierarchy
        for name in (_PREFIX + owner, _OF_PROCESS_1):
            group, parent = group / name, group
            group.mkdir()
            for setting in _HANDED_DOWN:
                if (parent / setting).exists():
                    (group / setting).write_text((parent / setting).read_text())
        (group / "cgroup.procs").write_text("0")  # itself
        for setting, weight in _GROUP_WEIGHTS.items():
            if (group.parent / setting).exists():
                (group.parent / setting).write_text(str(weight))


def remove_groups(is_gone: Callable[[str], bool]) -> list[Path]:
    """Removes the control groups of owners that are gone; returns those that still have processes."""
    gone = [group for group, owner in _owned_groups() if is_gone(owner)]
    for group in gone:
        for folder in (*sorted(filter(Path.is_dir, group.rglob("*")), reverse=True), group):
            with contextlib.suppress(OSError):
                folder.rmdir()
    return [group for group in gone if group.exists()]


def _owned_groups() -> Iterator[tuple[Path, str]]:
    for hierarchy in _hierarchies():
        for group in hierarchy.glob(f"{_PREFIX}*"):
            yield group, group.name.removeprefix(_PREFIX)


def _hierarchies() -> Iterator[Path]:
    if (_ROOT / "cgroup.procs").exists():
        yield _ROOT
    elif _ROOT.exists():
        yield from (
            hierarchy
            for hierarchy in sorted(_ROOT.iterdir())
            if not hierarchy.is_symlink() and (hierarchy / "cgroup.procs").exists()
        )
