"""A virtual machine with a real WiFi stack: Debian's kernel with mac80211_hwsim, hostapd and NetworkManager.

QEMU emulates the machine in software and gives it no network: it shares the checkout and the packages read-only, runs
the flights by itself when it boots, writes what it found into a shared folder, and switches itself off.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.system.wifi.flights import Found

CHECKOUT = Path(__file__).parents[3]
SUITE = "bookworm"
PYTHON = (3, 11)  # of that suite: packages with code of their own fit no other
NEEDED = ("qemu-system-x86_64", "debootstrap", "mke2fs")
PACKAGES = (
    "systemd-sysv,libpam-systemd,udev,kmod,iproute2,iputils-ping,iw,wpasupplicant,hostapd,dnsmasq-base,network-manager,dbus,python3,"
    "linux-image-amd64"
)
UNIT = """
[Unit]
Description=Flights over WiFi
After=dbus.service
[Service]
Type=oneshot
ExecStartPre=/sbin/modprobe 9pnet_virtio
ExecStartPre=/bin/mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=512000 checkout /checkout
ExecStartPre=/bin/mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=512000 packages /packages
ExecStartPre=/bin/mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000 found /found
Environment=PYTHONPATH=/checkout/src:/checkout:/packages PYTHONDONTWRITEBYTECODE=1
ExecStart=/bin/sh -c 'eval exec python3 -m tests.system.wifi.flights $(cat /found/cases) >/found/output 2>&1'
ExecStopPost=/sbin/poweroff
[Install]
WantedBy=multi-user.target
"""
UNMANAGED = "[keyfile]\nunmanaged-devices=interface-name:wlan1;interface-name:wlan2\n"  # the access points


def why_not() -> str:
    """What keeps this computer from running the machine; empty if nothing does."""
    if os.geteuid() != 0:
        return "building the machine needs root"
    missing = [program for program in NEEDED if shutil.which(program, path=_path()) is None]
    if missing:
        return f"{', '.join(missing)} not installed: apt-get install qemu-system-x86 debootstrap e2fsprogs"
    if sys.version_info[:2] != PYTHON:
        return f"the machine has Python {'.'.join(map(str, PYTHON))}, and these packages are for another one"
    return ""


def is_built(folder: Path) -> bool:
    """Whether the machine's disk lies in the folder."""
    return (folder / "disk.img").exists()


def build(folder: Path) -> None:
    """Makes the machine's disk, kernel and first file system in the folder, from Debian's packages; takes minutes."""
    root = folder / "root"
    shutil.rmtree(root, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    _run("debootstrap", "--variant=minbase", f"--include={PACKAGES}", SUITE, str(root))
    for name in ("checkout", "packages", "found"):
        (root / name).mkdir()
    (root / "etc/fstab").write_text("/dev/vda / ext4 defaults 0 1\n")
    (root / "etc/NetworkManager/conf.d/access-points.conf").write_text(UNMANAGED)
    (root / "etc/systemd/system/flights.service").write_text(UNIT)
    wanted = root / "etc/systemd/system/multi-user.target.wants/flights.service"
    wanted.symlink_to("/etc/systemd/system/flights.service")
    units = root / "etc/systemd/system"
    for name in ("hostapd", "wpa_supplicant-nl80211", "systemd-networkd", "apt-daily.timer"):
        unit = units / (name if "." in name else f"{name}.service")
        unit.unlink(missing_ok=True)
        unit.symlink_to("/dev/null")
    for place in (units, units / "multi-user.target.wants"):
        (place / "NetworkManager.service").unlink(missing_ok=True)
    for name in ("vmlinuz", "initrd.img"):
        (found,) = (root / "boot").glob(f"{name}-*")
        shutil.copy(found, folder / name)
    _run("mke2fs", "-q", "-t", "ext4", "-d", str(root), str(folder / "half.img"), "2G")
    (folder / "half.img").rename(folder / "disk.img")
    shutil.rmtree(root)


def flights(folder: Path, cases: Sequence[str], found: Path, *, timeout_s: float) -> list[Found]:
    """Boots the machine, which flies the cases, or all; their logs lie in `found`. Raises TimeoutExpired."""
    (found / "cases").write_text(" ".join(map(shlex.quote, cases)))
    shares = {"checkout": CHECKOUT, "packages": Path(sysconfig.get_path("purelib")), "found": found}
    with (found / "qemu.log").open("wb") as log:
        subprocess.run(
            [
                *("qemu-system-x86_64", "-accel", "tcg,thread=multi"),
                *("-cpu", "max", "-m", "2048", "-smp", "2"),
                *("-display", "none", "-no-reboot", "-nic", "none", "-serial", f"file:{found}/console.log"),
                *("-kernel", f"{folder}/vmlinuz", "-initrd", f"{folder}/initrd.img"),
                *("-append", "root=/dev/vda rw console=ttyS0 quiet systemd.show_status=no"),
                *("-drive", f"file={folder}/disk.img,format=raw,if=virtio,snapshot=on"),
                *_shared(shares),
            ],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            timeout=timeout_s,
            check=True,
            env={**os.environ, "PATH": _path()},
        )
    return [Found(**json.loads(line)) for line in (found / "flights").read_text().splitlines()]


def _shared(folders: dict[str, Path]) -> Iterator[str]:
    for tag, folder in folders.items():
        access = "" if tag == "found" else ",readonly=on"
        yield "-virtfs"
        yield f"local,path={folder},mount_tag={tag},security_model=none{access}"


def _run(*command: str) -> None:
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "PATH": _path()}
    )
    if done.returncode:
        raise SystemExit(f"{command[0]} ended with {done.returncode}: {(done.stdout + done.stderr)[-800:]}")


def _path() -> str:
    return f"{os.environ['PATH']}:/usr/sbin:/sbin"
