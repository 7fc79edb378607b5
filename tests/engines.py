"""A container engine of a test's own: a daemon of LXD or Incus in a folder, of which nothing is left in the end."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from tests.children import processes

Kind = Literal["lxd", "incus"]
_READY_S = 60
_STOP_S = 20.0
_PRESEED = """\
config: {}
storage_pools:
- {name: default, driver: dir}
profiles:
- {name: default, devices: {}}
"""


def _own_subnet() -> str:
    """A random one: a session that is killed leaves its containers' routes on the machine."""
    return f"10.{160 + secrets.randbelow(96)}.{secrets.randbelow(256)}.0/24"


@dataclass(frozen=True)
class OwnEngine:
    """One that runs: its socket, its command line, and addresses for its containers."""

    kind: Kind
    folder: Path
    subnet: str = field(default_factory=_own_subnet)

    @property
    def socket(self) -> Path:
        return self.folder / "unix.socket"

    def command(self, *arguments: str, given: str = "") -> str:
        """What the engine's own client answers; raises CalledProcessError."""
        program = "lxc" if self.kind == "lxd" else "incus"
        return subprocess.run(
            (program, *arguments), env=_environment(self.kind, self.folder), input=given, capture_output=True,
            check=True, text=True, timeout=60.0,
        ).stdout  # fmt: skip

    def process_1(self, container: str) -> int:
        """The id of a running container's first process."""
        lines = self.command("info", container).splitlines()
        return next(int(line.split()[1]) for line in lines if line.lower().startswith("pid:"))

    def running(self) -> list[str]:
        """The names of the containers that run or are frozen."""
        return [name for name, state in self._states() if state != "STOPPED"]

    def frozen(self) -> list[str]:
        """The names of the frozen ones."""
        return [name for name, state in self._states() if state == "FROZEN"]

    def there(self) -> list[str]:
        """The names of all containers."""
        return [name for name, _ in self._states()]

    def _states(self) -> list[list[str]]:
        return [line.split(",") for line in self.command("list", "-f", "csv", "-c", "ns").split()]


def why_not(kind: Kind) -> str:
    """Why no engine of that kind can be started here; empty where it can."""
    if os.geteuid() != 0:
        return "a container engine needs root"
    if shutil.which(_daemon(kind)) is None:
        return f"no {kind} here: tests/system/install-packages installs what it can"
    return ""


@contextlib.contextmanager
def own_engine(kind: Kind) -> Iterator[OwnEngine]:
    """A fresh engine, with a pool named default and no network, until the end of the block."""
    home = Path(tempfile.mkdtemp(prefix=f"upwash-{kind}-"))
    home.chmod(0o711)  # containers are other users
    folder = home / "engine"
    folder.mkdir(mode=0o711)
    environment = _environment(kind, folder)
    with (home / f"{kind}.log").open("wb") as log:
        process = subprocess.Popen(
            (_daemon(kind), "--group", "root"), env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            start_new_session=True,
        )  # fmt: skip
    admin = ("lxd",) if kind == "lxd" else ("incus", "admin")
    try:
        subprocess.run(
            (*admin, "waitready", f"--timeout={_READY_S}"), env=environment, check=True, timeout=_READY_S + 5
        )
        subprocess.run(
            (*admin, "init", "--preseed"), env=environment, input=_PRESEED, text=True, check=True, timeout=60
        )
        yield OwnEngine(kind, folder)
    finally:
        _end(process, (*admin, "shutdown", "--timeout=15"), environment, folder)
        shutil.rmtree(home, ignore_errors=True)


def _end(
    process: subprocess.Popen[bytes], shutdown: tuple[str, ...], environment: dict[str, str], folder: Path
) -> None:
    with contextlib.suppress(subprocess.TimeoutExpired):
        subprocess.run(shutdown, env=environment, timeout=_STOP_S, check=False)
    try:
        process.wait(timeout=_STOP_S)
    except subprocess.TimeoutExpired:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    unmount_below(folder)
    for _ in range(100):  # what was started for containers in the folder: their monitors, which name it
        left = [each.pid for each in processes() if str(folder) in each.command and each.pid != os.getpid()]
        if not left:
            break
        for process_id in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process_id, signal.SIGKILL)
        time.sleep(0.05)


def unmount_below(folder: Path) -> None:
    """Takes away what is mounted in the folder."""
    mounts = [line.split()[1] for line in Path("/proc/self/mounts").read_text().splitlines()]
    for mount in sorted((each for each in mounts if each.startswith(f"{folder}/")), reverse=True):
        subprocess.run(("umount", "--lazy", mount), check=False)


def _daemon(kind: Kind) -> str:
    return "lxd" if kind == "lxd" else "/usr/libexec/incus/incusd"


def _environment(kind: Kind, folder: Path) -> dict[str, str]:
    home = folder.parent / f"{kind}-client"
    places = {f"{kind.upper()}_DIR": str(folder)} | dict.fromkeys(
        ("HOME", "LXD_CONF", "INCUS_CONF"), str(home)
    )
    return os.environ | places
