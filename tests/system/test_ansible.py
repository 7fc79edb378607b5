"""The Ansible role: a box of its own namespace, with an /etc and an /opt of its own, and a real daemon."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from tests.children import is_alive
from tests.waiting import wait_for

from upwash.real.trust.authority import make_keys, revoke

pytestmark = [
    pytest.mark.system,
    pytest.mark.root,
    pytest.mark.nightly,
    pytest.mark.timeout(900),
    pytest.mark.skipif(os.geteuid() != 0, reason="needs root, for a namespace"),
    pytest.mark.skipif(shutil.which("ansible-playbook") is None, reason="ansible-playbook is not installed"),
]

ROOT = Path(__file__).parents[2]
ROLE = ROOT / "deploy" / "ansible"
SERVICE = """
from upwash import service

@service
class Level:
    def version(self) -> int:
        return {version}
"""
SYSTEMCTL = r"""#!/bin/sh
# Does for one daemon what systemd does with the unit.
main() {
    was=$(cat /opt/main 2>/dev/null || echo 0)
    now=$(sed -n "s/.*process \([0-9]*\) has taken this daemon's place.*/\1/p" /opt/log 2>/dev/null | tail -n 1)
    now=${now:-$was}
    kill -0 "$now" 2>/dev/null && echo "$now" || echo 0
}
echo "$*" >>/opt/told
case "$*" in
"show --property MainPID"*) main ;;
show*) [ "$(main)" = 0 ] && state=inactive || state=active
    printf 'LoadState=loaded\nActiveState=%s\nSubState=x\n' "$state" ;;
is-enabled*) [ -f /opt/enabled ] ;;
enable*) touch /opt/enabled ;;
start* | restart*)
    running=$(main)
    [ "$running" = 0 ] || kill "$running"
    while kill -0 "$running" 2>/dev/null && [ "$running" != 0 ]; do sleep 0.1; done
    rm -f /opt/log /opt/ready
    exec 3>&-
    setsid runuser --user upwash -- $(sed -n 's/^ExecStart=//p' /etc/systemd/system/upwash.service) \
        >/opt/ready 2>/opt/log </dev/null &
    echo $! >/opt/runuser
    until grep -q "ready at" /opt/ready; do kill -0 $! && sleep 0.2 || exit 1; done
    pgrep --parent $! >/opt/main ;;
kill*) kill -USR2 "$(main)" ;;
esac
"""
ENTER = r"""
set -e
mount --bind "$0/etc" /etc
mkdir -p "$0/opt/python" "$0/opt/libraries"
mount --bind "$0/opt" /opt
mount --bind "$BASE" /opt/python
mount --bind "$LIBRARIES" /opt/libraries
mount --bind "$0/log" /var/log
exec "$@"
"""


class Box:
    """A machine that Ansible finds at its own place: localhost, in a mount namespace."""

    def __init__(self, folder: Path, wheel: Path) -> None:
        self.folder = folder
        self.etc = folder / "etc/upwash"
        self.keys = folder / "keys"
        make_keys(self.keys, servers=[["s1"]], drones=["d1"])
        for name in ("opt", "log", "bin", "home"):
            (folder / name).mkdir(parents=True)
        subprocess.run(["cp", "--archive", "/etc", folder / "etc"], check=True)
        (folder / "bin/systemctl").write_text(SYSTEMCTL)
        (folder / "bin/systemctl").chmod(0o755)
        (folder / "level.py").write_text(SERVICE.format(version=1))
        self.variables = {
            "ansible_connection": "local",
            "ansible_python_interpreter": sys.executable,
            "upwash_wheel": str(wheel),
            "upwash_keys": str(self.keys),
            "upwash_files": [str(folder / "level.py")],
            "upwash_daemon": {"listen": "127.0.0.1:0", "lease_s": 3},
            "upwash_runtime": {"sandbox": "off"},
            "upwash_services": [{"name": "level", "program": "level.py:Level"}],
        }

    def play(self, playbook: str = "site.yml", *options: str, **variables: object) -> tuple[int, str, int]:
        """The exit code of a run, what it printed, and the number of tasks that changed something."""
        inventory = self.folder / "inventory.yml"
        hosts = {"s1": None}
        inventory.write_text(yaml.safe_dump({"upwash": {"hosts": hosts, "vars": self.variables | variables}}))
        done = self.run(
            "ansible-playbook", "-i", inventory, "--skip-tags", "packages", *options, ROLE / playbook
        )
        said = done.stdout + done.stderr
        changed = re.search(r"^s1 +: ok=\d+ +changed=(\d+)", said, re.MULTILINE)
        return done.returncode, said, int(changed[1]) if changed else -1

    def changes_nothing(self, **variables: object) -> None:
        code, said, changed = self.play("site.yml", **variables)
        assert (code, changed) == (0, 0), said + self.log

    def run(self, *command: object) -> subprocess.CompletedProcess[str]:
        path = ":".join([f"{self.folder}/bin", "/opt/python/bin", os.environ["PATH"]])
        return subprocess.run(
            ["unshare", "--mount", "sh", "-c", ENTER, self.folder, *map(str, command)],
            env={
                **{"PATH": path, "HOME": f"{self.folder}/home", "LC_ALL": "C.UTF-8"},
                **{"BASE": sys.base_prefix, "LIBRARIES": sysconfig.get_path("purelib")},
                **{"LD_LIBRARY_PATH": "/opt/python/lib", "PIP_NO_INDEX": "1", "PIP_CONFIG_FILE": os.devnull},
                **{"ANSIBLE_NOCOLOR": "1", "ANSIBLE_PIPELINING": "1"},
            },
            capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip

    @property
    def main(self) -> int:
        return int(self.run("systemctl", "show", "--property", "MainPID").stdout)

    @property
    def log(self) -> str:
        return (self.folder / "opt/log").read_text()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture
def box(tmp_path: Path, wheel: Path) -> Iterator[Box]:
    made = Box(tmp_path, wheel)
    assert made.run("python3", "-m", "venv", "/opt/upwash").returncode == 0
    (libraries,) = made.folder.glob("opt/upwash/lib/python3*/site-packages")
    (libraries / "libraries.pth").write_text("/opt/libraries\n")  # nothing is downloaded
    try:
        yield made
    finally:
        if main := made.main:
            os.kill(main, signal.SIGTERM)
            wait_for(lambda: not is_alive(main), within_s=30.0)


def test_a_box_is_installed_changed_revoked_upgraded_and_otherwise_left_alone(box: Box, wheel: Path) -> None:
    code, said, _ = box.play("site.yml", "--check", "--diff")
    assert code == 0, said
    assert not box.etc.exists()

    code, said, _ = box.play("site.yml", "--diff")
    assert code == 0, said
    first = box.main
    assert first > 0
    assert {file.name for file in (box.etc / "keys").iterdir()} == {
        *("authority.pem", "s1.pem", "s1.key", "revoked.txt")
    }
    assert (box.etc / "keys/s1.key").stat().st_mode & 0o777 == 0o640
    secret = (box.keys / "s1.key").read_text().splitlines()[1]
    assert secret not in said
    assert not list(box.folder.glob("etc/**/authority.key"))

    box.changes_nothing()
    assert box.main == first

    (box.folder / "level.py").write_text(SERVICE.format(version=2))
    code, said, _ = box.play("site.yml", "--check", "--diff", upwash_servers=[{"name": "s1", "slots": 3}])
    assert code == 0, said
    assert "+slots = 3" in said
    assert "slots" not in (box.etc / "server.toml").read_text()
    code, said, _ = box.play(upwash_servers=[{"name": "s1", "slots": 3}])
    assert code == 0, said
    assert "services that changed: level" in box.log
    assert (box.main, "slots = 3" in (box.etc / "server.toml").read_text()) == (first, True)

    revoke(box.keys, ["d1"])
    code, said, _ = box.play("revoke.yml")
    assert code == 0, said
    assert "1 certificates are revoked" in box.log

    another = box.folder / wheel.name
    shutil.copy(wheel, another)
    with another.open("ab") as file:
        file.write(b"\0")  # another version, as far as its checksum says
    code, said, _ = box.play(upwash_wheel=str(another), upwash_servers=[{"name": "s1", "slots": 3}])
    assert code == 0, said
    assert box.main not in (0, first)
    box.changes_nothing(upwash_wheel=str(another), upwash_servers=[{"name": "s1", "slots": 3}])


def test_what_a_box_would_refuse_changes_nothing_there_and_stops_the_run(box: Box) -> None:
    code, said, _ = box.play()
    assert code == 0, said
    before = {file: file.read_bytes() for file in box.etc.rglob("*") if file.is_file()}
    peers = [{"name": "s2", "address": "127.0.0.1:1"}]
    (box.folder / "level.py").write_text("no service")
    for variables, why in (
        ({"upwash_servers": [{"name": "s1", "slots": -1}]}, "slots"),
        ({"upwash_peers": peers}, "peers cannot change while the daemon runs"),
        ({}, "level.py"),
    ):
        code, said, _ = box.play(**variables)
        assert code != 0
        assert re.search(f"TASK.*Check.*{re.escape(why)}", said, re.DOTALL), said
        in_place = {file: file.read_bytes() for file in before}
        assert in_place == before
    assert "orders a reload" not in box.log

    first = box.main
    (box.folder / "level.py").write_text(SERVICE.format(version=1))
    code, said, _ = box.play(upwash_peers=peers, upwash_take="hand-over")
    assert code == 0, said
    second = box.main
    assert second not in (0, first)
    code, said, _ = box.play(upwash_take="restart")
    assert code == 0, said
    assert box.main not in (0, first, second)


def test_the_first_box_that_refuses_is_the_last_that_is_asked(box: Box) -> None:
    hosts = box.folder / "hosts.yml"
    hosts.write_text(yaml.safe_dump({"upwash": {"hosts": {"s1": None, "s2": None}}}))
    code, said, _ = box.play("site.yml", "-i", str(hosts), upwash_wheel=str(box.folder / "none.whl"))
    assert code != 0
    assert re.search(r"^s1 +: .*failed=1", said, re.MULTILINE)
    assert not re.search(r"^s2 +:", said, re.MULTILINE)
    assert not (box.etc / "server.toml").exists()
