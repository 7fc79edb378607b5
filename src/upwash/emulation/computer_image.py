"""The image of a computer: a container with the host's /usr, in which an engine can run containers in turn."""

from __future__ import annotations

import json
import platform
from pathlib import Path

from upwash.packaging.archive import write_packed

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
