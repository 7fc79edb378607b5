"""Computers that are containers; servers on them run their services in containers of their own.

Their engine starts inside the emulation's enclosure and keeps its data in memory, so that the engine and its
containers always end with the enclosure. The image of a computer has the host's /usr, and lets another engine run
containers.
"""

from __future__ import annotations

import importlib.util
import json
import os
import platform
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from upwash.config.daemon import DaemonConfig
from upwash.config.runtime import ContainerNetworkConfig, RuntimeConfig
from upwash.emulation.enclosure import MARK, enter_groups
from upwash.emulation.namespaces import command, make_quiet, require_tools
from upwash.emulation.programs import Computers
from upwash.errors import EngineError, UpwashError, UsageError
from upwash.packaging.contents import extra_of
from upwash.packaging.image import Recipe, package, write_packed
from upwash.packaging.shipping import find_service
from upwash.support.loading import install_extra

_TOOLS = {
    "lxd": "lxd",
    "lxc": "lxd-client",
    "newuidmap": "uidmap",
    "nft": "nftables",
}
_OWN_FOLDERS = ("boot", "dev", "etc", "lost+found", "proc", "run", "sys", "var")  # not lent by this machine
_POOL = "default"
_IMAGE = "computer"
_ENGINE_FOLDER = "/run/lxd"
_SERVICES_IMAGES = Path("/run/images")
# The same users inside as outside: programs read the files that they would read outside, and no file changes hands.
_USERS = "root:0:1065536\n"
_READY_S = 30
_START_ENGINE = (
    f'setsid lxd --group root --logfile "$1" >/dev/null 2>&1 </dev/null & lxd waitready --timeout={_READY_S}'
)
_ENVIRONMENT = {
    "TMPDIR": "/var/tmp",  # noqa: S108 - the container's own
    "LXD_CONF": "/run/lxc",
    "LXD_SECURITY_APPARMOR": "false",  # no profiles in this machine's kernel, where they would stay
}


def require_containers() -> None:
    """Raises UsageError if containers are not possible here."""
    require_tools(_TOOLS)
    if importlib.util.find_spec("pylxd") is None:
        raise UsageError(f"containers need pylxd: `{install_extra('lxd')}` installs it")


class ContainerComputers(Computers):
    """Computers that see this machine's files, except the system's own, and may change the run's folder only."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._packaged: dict[str, Path] = {}
        enter_groups(os.environ[MARK])
        _lend_all_users()
        os.environ |= _ENVIRONMENT | {"LXD_DIR": _ENGINE_FOLDER, "TMPDIR": os.environ["TMPDIR"]}
        _start_engine(log=folder / "containers.log")
        self._describe_computers()

    def make(self, name: str) -> None:
        """Starts a container of that name, and registers its network namespace."""
        command("lxc", "launch", _IMAGE, name)
        command(*self.inside(name), *IS_UP)
        state = json.loads(command("lxc", "query", f"/1.0/instances/{name}/state"))
        command("ip", "netns", "attach", name, str(state["pid"]))
        make_quiet(name)

    def inside(self, name: str) -> tuple[str, ...]:
        """The prefix of a command line that runs it in the container."""
        return ("lxc", "exec", name, "--")

    def equip(self, name: str, daemon: DaemonConfig, *, subnet: str) -> RuntimeConfig:
        """Starts an engine in the container, with the services' images; returns the daemon's runtime table."""
        inside = self.inside(name)
        command(*inside, "sh", "-c", "echo 1 >/proc/sys/net/ipv4/ip_forward")
        _start_engine(inside, log=self._folder / f"{name}-containers.log")
        for image in daemon.images:
            command(*inside, "lxc", "image", "import", str(self._image(image.name, daemon)))
        return RuntimeConfig(kind="lxd", network=ContainerNetworkConfig(subnet=subnet))

    def _image(self, service: str, daemon: DaemonConfig) -> Path:
        if service not in self._packaged:
            recipe = Recipe(find_service(service, daemon), tuple(extra_of(service, "lxd")))
            self._packaged[service] = package(recipe, _SERVICES_IMAGES, report=lambda _: None)
        return self._packaged[service]

    def _describe_computers(self) -> None:
        with tempfile.TemporaryDirectory() as scratch:
            image = write_computer_image(Path(scratch))
            command("lxc", "image", "import", str(image), "--alias", _IMAGE)
        profile = ("lxc", "profile")
        command(*profile, "set", "default", "security.nesting=true", *_environment())
        device = (*profile, "device", "add", "default")
        command(*device, "root", "disk", "path=/", f"pool={_POOL}")
        _SERVICES_IMAGES.mkdir()
        for folder in (_SERVICES_IMAGES, *_lent_folders()):
            command(
                *device, f"lent-{folder.name}", "disk", f"source={folder}", f"path={folder}", "readonly=true"
            )
        command(*device, "run-folder", "disk", f"source={self._folder}", f"path={self._folder}")


def _start_engine(through: Sequence[str] = (), *, log: Path) -> None:
    """Start an engine with a storage pool, and return when it is ready."""
    try:
        command(*through, "sh", "-c", _START_ENGINE, "sh", str(log))
    except UpwashError as error:
        raise EngineError(f"LXD did not start; {log} says why") from error
    command(*through, "lxc", "storage", "create", _POOL, "dir")


def _lend_all_users() -> None:
    users = Path("/run/users")
    users.write_text(_USERS)
    for file in ("/etc/subuid", "/etc/subgid"):
        command("mount", "--bind", str(users), file)


def _environment() -> Iterator[str]:
    for name, value in (_ENVIRONMENT | {MARK: os.environ[MARK]}).items():
        yield f"environment.{name}={value}"


def _lent_folders() -> Iterator[Path]:
    for folder in sorted(Path("/").iterdir()):
        if folder.is_dir() and not folder.is_symlink() and folder.name not in _OWN_FOLDERS:
            yield folder


_FOLDERS = (
    *("usr", "etc", "dev", "proc", "sys", "run", "tmp", "root", "mnt", "sbin", "etc/lxc"),
    *("var/cache", "var/log/lxd", "var/lib/lxd", "var/lib/lxcfs", "var/tmp"),
    *("var/cache/incus", "var/log/incus", "var/lib/incus"),
)
_FROM_USR = ("bin", "lib", "lib64")
_FILES = {
    "passwd": "root:x:0:0::/root:/bin/sh\nnobody:x:65534:65534::/:/bin/false\n",
    "group": "root:x:0:\nnogroup:x:65534:\n",
    "hosts": "127.0.0.1 localhost\n",
    "subuid": "root:1000000:65536\n",
    "subgid": "root:1000000:65536\n",
}
# A host with the first version of control groups leaves their mounts to us. The shell reaps what process 1 inherits.
_INIT = """\
#!/bin/sh
ip link set lo up
if [ ! -e /sys/fs/cgroup/cgroup.controllers ]; then
    mount -t tmpfs cgroup /sys/fs/cgroup
    for controller in cpu cpuacct cpuset memory devices freezer blkio pids; do
        mkdir "/sys/fs/cgroup/$controller"
        mount -t cgroup -o "$controller" cgroup "/sys/fs/cgroup/$controller" || rmdir "/sys/fs/cgroup/$controller"
    done
    mkdir /sys/fs/cgroup/systemd
    mount -t cgroup -o none,name=systemd cgroup /sys/fs/cgroup/systemd
fi
touch /run/up
while :; do
    sleep infinity
done
"""
IS_UP = (
    "timeout",
    "10",
    "sh",
    "-c",
    "until [ -e /run/up ]; do sleep 0.02; done",
)  # ends when the computer is up


def write_computer_image(folder: Path) -> Path:
    """Makes the image in the folder and returns its file; its containers need the host's /usr as a device."""
    root = folder / "tree" / "rootfs"
    for name in _FOLDERS:
        (root / name).mkdir(parents=True, exist_ok=True)
    for name in _FROM_USR:
        (root / name).symlink_to(f"usr/{name}")
    for name, text in _FILES.items():
        (root / "etc" / name).write_text(text)
    init = root / "sbin" / "init"
    init.write_text(_INIT)
    init.chmod(0o755)
    metadata = {"architecture": platform.machine(), "creation_date": 1, "properties": {}}
    (folder / "tree" / "metadata.yaml").write_text(json.dumps(metadata))
    file = folder / "computer.tar.gz"
    write_packed(folder / "tree", file)
    return file
