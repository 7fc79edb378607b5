"""The system below a service: the host's own /usr, lent to each container, or a Debian of the image's own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Literal

from upwash.errors import UsageError

Base = Literal["host", "debootstrap"]

PYTHON = "/usr/bin/python3"  # in the image
ENVIRONMENT = {
    "PATH": "/usr/sbin:/usr/bin",
    "HOME": "/tmp",  # noqa: S108 - its own
    "LANG": "C.UTF-8",
    "PYTHONPATH": "/opt/upwash/lib",
    "PYTHONDONTWRITEBYTECODE": "1",
    "PYTHONNOUSERSITE": "1",
}

_SUITES = {(3, 11): "bookworm", (3, 13): "trixie"}
_PACKAGES = "python3,nftables,mount,libstdc++6"
_MOUNT_POINTS = ("usr", "dev", "proc", "sys", "run", "tmp", "root", "mnt", "etc", "var")
_FROM_USR = ("bin", "lib", "lib64")
_INIT = f"""\
#!/bin/sh
export {" ".join(f"{name}={value}" for name, value in ENVIRONMENT.items())}
exec {PYTHON} -m upwash.real.instances.lxd.init
"""


def lay_base(base: Base, root: Path) -> None:
    """Makes the base system in the empty folder `root`; raises UsageError with the remedy."""
    if base == "host":
        _refuse_other_python()
        _skeleton(root)
    else:
        _debian(root)


def lay_init(base: Base, root: Path) -> None:
    """Adds the init program that LXD or Incus starts; raises UsageError with the remedy."""
    if base == "host" and (shutil.which("nft") is None or shutil.which("setpriv") is None):
        raise UsageError("--base host needs nft and setpriv: apt install nftables util-linux")
    init = root / ("sbin" if base == "host" else "usr/sbin") / "init"
    init.unlink(missing_ok=True)
    init.write_text(_INIT)
    init.chmod(0o755)


def _skeleton(root: Path) -> None:
    """Mount points and links: programs and libraries come from the /usr of the host that the container runs on."""
    for name in _MOUNT_POINTS:
        (root / name).mkdir()
    (root / "tmp").chmod(0o1777)  # engines give what they mount there the same rights
    for name in _FROM_USR:
        (root / name).symlink_to(f"usr/{name}")
    (root / "sbin").mkdir()
    (root / "etc" / "passwd").write_text("root:x:0:0::/root:/bin/false\nservice:x:1000:1000::/:/bin/false\n")
    (root / "etc" / "group").write_text("root:x:0:\nservice:x:1000:\n")
    (root / "etc" / "hosts").write_text("127.0.0.1 localhost\n")


def _debian(root: Path) -> None:
    suite = _SUITES.get(sys.version_info[:2])
    if suite is None:
        raise UsageError(
            f"no Debian has the Python {sys.version_info[0]}.{sys.version_info[1]} that runs here: package with "
            + " or ".join(f"{major}.{minor} ({name})" for (major, minor), name in _SUITES.items())
        )
    if shutil.which("debootstrap") is None or os.geteuid() != 0:
        raise UsageError("--base debootstrap needs root and debootstrap: apt install debootstrap")
    made = subprocess.run(  # noqa: S603
        ("debootstrap", "--variant=minbase", f"--include={_PACKAGES}", suite, str(root)),  # noqa: S607
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if made.returncode:
        raise UsageError(f"debootstrap failed: {' / '.join(made.stdout.splitlines()[-3:])}")
    for left in ("var/cache/apt", "var/lib/apt/lists", "var/log", "usr/share/doc", "usr/share/man"):
        shutil.rmtree(root / left, ignore_errors=True)
        (root / left).mkdir(parents=True)
    for name in ("etc/machine-id", "etc/resolv.conf", "etc/hostname", "var/cache/ldconfig/aux-cache"):
        (root / name).unlink(missing_ok=True)


def _refuse_other_python() -> None:
    """The distributions that are copied were built for the Python that runs here."""
    asked = (PYTHON, "-c", "import sys; print(*sys.version_info[:2])")
    try:
        found = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()  # noqa: S603
    except (OSError, subprocess.CalledProcessError) as error:
        raise UsageError(f"--base host needs Debian's Python: apt install python3 ({error})") from error
    here = [str(part) for part in sys.version_info[:2]]
    if found != here:
        raise UsageError(
            f"{PYTHON} is Python {'.'.join(found)}, but this is {'.'.join(here)}: run upwash with the former, "
            "or use --base debootstrap"
        )
