"""A Podman of a test's own, in a folder, that answers to Docker's API; nothing of it is left in the end."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.engines import unmount_below
from tests.waiting import wait_for

_END_S = 20.0
# What a machine without systemd's part in control groups, and with low limits of its own, lets through.
_SETTINGS = """\
[containers]
default_ulimits = ["nofile=4096:4096", "nproc=4096:4096"]
[engine]
cgroup_manager = "cgroupfs"
events_logger = "file"
{runtime}
"""


@dataclass(frozen=True)
class OwnPodman:
    """One that runs: its socket, and its command line."""

    folder: Path

    @property
    def socket(self) -> Path:
        return self.folder / "podman.sock"

    def command(self, *arguments: str) -> str:
        """What Podman's own command answers; raises CalledProcessError."""
        return subprocess.run(
            (*_podman(self.folder), *arguments), env=_environment(self.folder), capture_output=True, check=True,
            text=True, timeout=60.0,
        ).stdout  # fmt: skip

    def running(self) -> list[str]:
        """The ids of the containers that run or are frozen."""
        return self._in("running", "paused")

    def frozen(self) -> list[str]:
        """The ids of the frozen ones."""
        return self._in("paused")

    def there(self) -> list[str]:
        """The ids of all containers."""
        return self.command("ps", "--all", "--quiet", "--no-trunc").split()

    def process_1(self, container: str) -> int:
        """The id of a running container's first process."""
        return int(self.command("inspect", "--format", "{{.State.Pid}}", container))

    def _in(self, *states: str) -> list[str]:
        containers = json.loads(self.command("ps", "--all", "--format", "json"))
        return [container["Id"] for container in containers if container["State"] in states]


def why_not() -> str:
    """Why no Podman can be started here; empty where it can."""
    if os.geteuid() != 0:
        return "a Podman of a test's own needs root"
    if shutil.which("podman") is None:
        return "no podman here: tests/system/install-packages installs it"
    return ""


@contextlib.contextmanager
def own_podman() -> Iterator[OwnPodman]:
    """A fresh one, without images, until the end of the block."""
    folder = Path(tempfile.mkdtemp(prefix="upwash-podman-"))
    runtime = 'runtime = "runc"' if shutil.which("runc") else ""
    (folder / "containers.conf").write_text(_SETTINGS.format(runtime=runtime))
    podman = OwnPodman(folder)
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            (*_podman(folder), "system", "service", "--time=0", f"unix://{podman.socket}"),
            cwd=folder,  # where a note is left of each container that ran out of memory
            env=_environment(folder), stdin=subprocess.DEVNULL, stdout=log, stderr=log,
        )  # fmt: skip
    try:
        wait_for(podman.socket.exists, within_s=30.0, seen=(folder / "log").read_text)
        yield podman
    finally:
        with contextlib.suppress(subprocess.CalledProcessError):
            podman.command("rm", "--all", "--force", "--time=0")
        process.terminate()
        process.wait(timeout=_END_S)
        unmount_below(folder)
        shutil.rmtree(folder, ignore_errors=True)


def _podman(folder: Path) -> tuple[str, ...]:
    return ("podman", f"--root={folder}/storage", f"--runroot={folder}/run", f"--tmpdir={folder}/tmp")


def _environment(folder: Path) -> dict[str, str]:
    return {**os.environ, "CONTAINERS_CONF": str(folder / "containers.conf")}
