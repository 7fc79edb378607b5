"""People who write missions at a desk need no Linux; where a command needs Linux, it says so."""

from __future__ import annotations

import os
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

THESIS = Path(__file__).parents[2] / "scenarios" / "thesis.toml"

# Found by every Python process below, workers too. Names and calls that Python has on Linux, and not on macOS.
WITHOUT_LINUX = """
import fcntl, os, resource, select, signal, socket, sys, time

NAMES = {
    fcntl: ("F_ADD_SEALS", "F_GETPIPE_SZ", "F_OFD_GETLK", "F_OFD_SETLK", "F_OFD_SETLKW", "F_SETPIPE_SZ"),
    os: (
        "copy_file_range", "eventfd", "getrandom", "getresuid", "memfd_create", "pidfd_open", "pipe2", "setns",
        "posix_fadvise", "posix_fallocate", "sched_getaffinity", "sched_setaffinity", "setresuid", "splice",
        "unshare", "waitid", "O_DIRECT", "O_NOATIME", "O_PATH", "O_TMPFILE", "P_PIDFD",
    ),
    resource: ("prlimit", "RLIMIT_MSGQUEUE", "RLIMIT_NICE", "RLIMIT_RTPRIO", "RLIMIT_SIGPENDING"),
    select: ("epoll",),
    signal: ("sigtimedwait", "sigwaitinfo", "SIGPWR", "SIGRTMAX", "SIGRTMIN", "SIGSTKFLT"),
    socket: (
        "AF_NETLINK", "AF_PACKET", "MSG_CMSG_CLOEXEC", "MSG_NOSIGNAL", "SCM_CREDENTIALS", "SOCK_CLOEXEC",
        "SOCK_NONBLOCK", "SO_BINDTODEVICE", "SO_PASSCRED", "SO_PEERCRED", "TCP_KEEPIDLE", "TCP_USER_TIMEOUT",
    ),
    time: ("CLOCK_BOOTTIME", "CLOCK_TAI"),
}
for module, names in NAMES.items():
    for name in names:
        module.__dict__.pop(name, None)

def require_elsewhere(path):
    if isinstance(path, (str, os.PathLike)) and os.fspath(path).startswith(("/proc", "/sys/")):
        raise FileNotFoundError(2, "there is none on macOS", os.fspath(path))

def elsewhere(call):
    def checked(path=".", *rest, **named):
        require_elsewhere(path)
        return call(path, *rest, **named)
    return checked

for name in ("listdir", "lstat", "readlink", "scandir", "stat"):
    setattr(os, name, elsewhere(getattr(os, name)))
sys.addaudithook(lambda event, of: require_elsewhere(of[0]) if event == "open" else None)
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of `upwash init`, and the environment's module, all made without Linux."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "sitecustomize.py").write_text(WITHOUT_LINUX)
    upwash(folder, "init", "patrol")
    return folder


def environment(folder: Path) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join((str(folder), os.environ.get("PYTHONPATH", "")))}


def upwash(folder: Path, *arguments: str, code: int = 0) -> str:
    """What the command prints, which ends as it should."""
    done = subprocess.run(
        [sys.executable, "-m", "upwash", *arguments],
        cwd=folder, env=environment(folder), capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    return done.stdout if code == 0 else done.stderr


def test_the_module_hides_what_is_linuxs(project: Path) -> None:
    code = (
        "import os; print(hasattr(os, 'memfd_create'), os.path.exists('/proc/self')); open('/proc/self/stat')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(project), capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (1, "False False\n")
    assert "there is none on macOS" in done.stderr


@pytest.mark.parametrize(
    "command",
    [("serve", "--config", "patrol/server.toml"), ("demo",), ("emulate", str(THESIS))],
    ids=" ".join,
)
def test_a_command_that_needs_linux_says_so(command: tuple[str, ...], project: Path) -> None:
    assert upwash(project, *command, code=2) == (
        f"upwash: {command[0]} needs Linux: run it on a Linux computer or virtual machine\n"
    )


@pytest.fixture(scope="module")
def log(project: Path) -> Path:
    upwash(project, "simulate", "patrol/drone.toml", "--log", "events.jsonl")
    return project / "events.jsonl"


def test_a_mission_is_simulated_and_reported(project: Path, log: Path) -> None:
    assert "mission time" in upwash(project, "simulate", "patrol/drone.toml")
    upwash(project, "report", str(log), "-o", "page.html", "--csv", "calls.csv", "--json")
    assert (project / "page.html").stat().st_size > (project / "calls.csv").stat().st_size > 0


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_mission_is_checked_and_policies_are_compared(project: Path, workers: str) -> None:
    assert "waypoint" in upwash(project, "check", str(THESIS), "--workers", workers)
    assert "look-ahead" in upwash(project, "compare", str(THESIS), "--seeds", "2", "--workers", workers)


@pytest.fixture
def page(project: Path, log: Path) -> Iterator[str]:
    """The address of `upwash view`."""
    command = [sys.executable, "-m", "upwash", "view", str(log), "--port", "0"]
    with subprocess.Popen(command, env=environment(project), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process.stdout.readline().partition(" ready at ")[2].strip()
        process.terminate()


def test_a_flight_is_shown(page: str) -> None:
    with urllib.request.urlopen(page, timeout=30) as answer:
        assert b"<html" in answer.read()
