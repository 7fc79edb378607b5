"""Two radios that are cables to a server each, and a real NetworkManager, away from this machine's own."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs/networks.md"
NEEDED = ("NetworkManager", "nmcli", "dbus-daemon", "dnsmasq", "ip", "unshare", "nsenter", "setpriv")


@dataclass(frozen=True)
class Field:
    """Two radios, s1 and s2 at the other end of each, and the manager."""

    folder: Path
    process: subprocess.Popen[str]

    def entered(self, *command: str, among: str = "") -> list[str]:
        """A command among the radios, or at a server."""
        place = ["ip", "netns", "exec", among] if among else []
        inside = ["nsenter", f"--target={self.process.pid}", "--net", "--mount", f"--wd={self.folder}", "--"]
        return [*inside, *place, *command]

    def run(self, *command: str) -> str:
        """Runs a command among the radios; returns what it said."""
        done = subprocess.run(self.entered(*command), capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def active(self) -> str:
        """The profiles that are active."""
        return self.run("nmcli", "-g", "NAME", "connection", "show", "--active")

    def cut_cable(self, number: int) -> None:
        self.run("ip", "-n", f"s{number}", "link", "set", f"ap{number}", "down")

    def mend_cable(self, number: int) -> None:
        self.run("ip", "-n", f"s{number}", "link", "set", f"ap{number}", "up")

    def stop_dhcp(self, number: int) -> None:
        self.run("sh", "-c", f"kill $(cat {self.folder}/dnsmasq{number}.pid)")

    def kill_manager(self) -> None:
        self.run("sh", "-c", f"kill -9 $(cat {self.folder}/manager.pid)")

    def start_manager(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        print(file=self.process.stdin, flush=True)
        assert self.process.stdout.readline() == "ready\n"

    def addresses(self) -> str:
        return self.run("ip", "-brief", "-4", "address")


def field_below(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Field]:
    """The field, until it is asked for a second time."""
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root")
    path = f"{os.environ['PATH']}:/usr/sbin:/sbin"
    monkeypatch.setenv("PATH", path)
    missing = [program for program in NEEDED if shutil.which(program, path=path) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed: tests/system/install-packages installs them")
    if not Path("/usr/lib/polkit-1/polkitd").exists():
        pytest.skip("polkitd is not installed: tests/system/install-packages installs it")
    tmp_path.chmod(0o755)
    (tmp_path / "rules.d").mkdir()
    (rule,) = re.findall(r"```js\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    (tmp_path / "rules.d" / "50-upwash.rules").write_text(rule.replace('"drone"', '"nobody"'))
    monkeypatch.setenv("DBUS_SYSTEM_BUS_ADDRESS", f"unix:path={tmp_path}/bus")
    with subprocess.Popen(
        [str(Path(__file__).with_name("radios.sh")), str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield Field(tmp_path, process)
        finally:
            process.terminate()
