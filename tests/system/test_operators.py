"""The how-to for operators: its commands in their order, as far as they run without root, systemd and downloads."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.children import is_alive
from tests.programs import ended
from tests.system.daemons import shown
from tests.system.flying import Flying
from tests.waiting import wait_for

from upwash.cli.exit_codes import ExitCode
from upwash.config.daemon import read_daemon_config
from upwash.errors import Unreachable
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.authority import make_keys
from upwash.rpc.protocol import AVAILABILITY

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "servers.md").read_text()
UNIT = ROOT / "deploy" / "upwash.service"
NOT_HERE = (
    *("apt-get", "python3 -m venv", "/opt/upwash/bin/pip", "useradd", "systemctl daemon-reload"),
    *("journalctl", "podman", "docker"),
)


SERVICE = """
from upwash import service

@service
class Level:
    def version(self) -> int:
        return {version}
"""


class Machine:
    """A folder that stands in for the machine: /etc and /opt lie in it, and it starts the daemon as the unit says."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.daemon: subprocess.Popen[str] | None = None
        self.process = 0  # the daemon's, or its successor's
        self.address = ""
        (folder / "etc/systemd/system").mkdir(parents=True)
        (folder / "upwash").symlink_to(ROOT)
        (folder / "opt/upwash/bin").mkdir(parents=True)
        script = folder / "opt/upwash/bin/upwash"
        script.write_text(f'#!/bin/sh\nexec {sys.executable} -m upwash "$@"\n')
        script.chmod(0o755)

    def run(self, command: str) -> str:
        """What the command prints; it must do its work."""
        match command.split()[:2]:
            case ["systemctl", "enable" | "restart"]:
                self.stop()
                self.start()
                return ""
            case ["systemctl", "reload"]:
                return self.reload()
            case ["systemctl", "kill"]:
                return self.change()
        here = self._here(command.replace(" -g upwash", "")).replace("127.0.0.1:7070", self.address)
        path = f"{self.folder}/opt/upwash/bin:{os.environ['PATH']}"
        done = subprocess.run(
            here, shell=True, cwd=self.folder, capture_output=True, text=True, timeout=60, check=False,
            env={**os.environ, "PATH": path},
        )  # fmt: skip
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return done.stdout

    def start(self) -> None:
        """Starts the daemon with the installed unit's command."""
        unit = (self.folder / "etc/systemd/system/upwash.service").read_text()
        (command,) = re.findall(r"^ExecStart=(.*)$", unit, re.MULTILINE)
        with (self.folder / "log").open("a") as log:
            self.daemon = subprocess.Popen(
                shlex.split(self._here(command)), stdout=subprocess.PIPE, stderr=log, text=True
            )
        assert self.daemon.stdout is not None
        self.address = self.daemon.stdout.readline().strip().removeprefix("s1 ready at ")
        assert self.address, (self.folder / "log").read_text()
        self.process = self.daemon.pid

    def reload(self) -> str:
        """Runs the unit's ExecReload, and returns what the log says of it."""
        assert self.daemon is not None
        log = self.folder / "log"
        known = len(log.read_text())
        unit = (self.folder / "etc/systemd/system/upwash.service").read_text()
        (command,) = re.findall(r"^ExecReload=(.*)$", unit, re.MULTILINE)
        self.run(command.replace("$MAINPID", str(self.process)))
        return log.read_text()[known:]

    def change(self) -> str:
        """Has another process take the daemon's place, and returns what the log says of it."""
        assert self.daemon is not None
        self.daemon.send_signal(signal.SIGUSR2)
        assert self.daemon.wait(timeout=60.0) == 0
        said = (self.folder / "log").read_text()
        (process,) = re.findall(r"process (\d+) has taken this daemon's place", said)
        self.process = int(process)
        return said

    def stop(self) -> None:
        """Ends the daemon if it runs."""
        if self.daemon is not None:
            os.kill(self.process, signal.SIGTERM)
            wait_for(lambda: not is_alive(self.process), within_s=20.0)
            assert self.daemon.wait(timeout=20.0) == 0
            assert self.daemon.stdout is not None
            self.daemon.stdout.close()
            self.daemon = None

    def _here(self, text: str) -> str:
        return re.sub(r"(?<![\w.])/(etc|opt)/", rf"{self.folder}/\1/", text)


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[Machine]:
    made = Machine(tmp_path)
    try:
        yield made
    finally:
        if made.daemon is not None:
            for process in {made.process, made.daemon.pid}:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)
            made.daemon.communicate()


class Day:
    """The page from its first command to its last, while a drone of each of two teams calls on."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.etc = machine.folder / "etc" / "upwash"
        self.drones: list[Flying] = []
        self.enough = asyncio.Event()

    async def run(self) -> None:
        """Runs all commands; no call of the drones may fail."""
        async with asyncio.timeout(180.0), asyncio.TaskGroup() as flights:
            for title, commands in sections():
                for command in commands:
                    self.prepare(command)
                    printed = await asyncio.to_thread(self.machine.run, command)
                    if "--drone alpha-1" in command:
                        await self.begin(flights)
                    self.look(command, printed)
                await self.ended(title)
            self.enough.set()

    def prepare(self, command: str) -> None:
        """Does what the page has an operator do in an editor, or what befalls the machine."""
        settings = self.etc / "server.toml"
        if command == "systemctl reload upwash" and "slots" not in settings.read_text():
            settings.write_text(settings.read_text() + "slots = 4\n")
        elif command.startswith("install -m 644 my_services.py"):
            (self.machine.folder / "my_services.py").write_text(SERVICE.format(version=2))
        elif "--inventory" in command:
            listed = f'[[server]]\nname = "s1"\naddress = "{self.machine.address}"\n'
            (self.machine.folder / "boxes.toml").write_text(listed)
        elif command.startswith("tar -x"):
            shutil.rmtree(self.etc)

    def look(self, command: str, printed: str) -> None:
        """What a command must have brought about at once."""
        if command.startswith("install -d -m 750"):
            (self.etc / "my_services.py").write_text(SERVICE.format(version=1))
            (self.etc / "server.toml").write_text(settings_of_the_page())
        elif "--inventory" in command:
            assert "well: 1 of 1" in printed
        elif " status " in command:
            used = r"2 of 4" if self.drones else r"0 of \d+"
            assert re.search(rf"^s1: {used} slots in use$", printed, re.MULTILINE)
            assert "level" in printed
        elif command == "systemctl reload upwash":
            self.said = printed

    async def begin(self, flights: asyncio.TaskGroup) -> None:
        """A drone of each team takes off."""
        program = f"{self.etc}/my_services.py:Level"
        for name in ("alpha-1", "beta-1"):
            drone = Flying(name, self.machine.address, self.machine.folder / "keys", program, "version")
            here = asyncio.Event()
            flights.create_task(drone.fly(self.enough, here.set))
            await here.wait()
            self.drones.append(drone)
            await drone.hears(1)

    async def ended(self, title: str) -> None:
        """What a section must have brought about."""
        match title:
            case "Change a service":
                assert "services that changed: level" in self.said
                for drone in self.drones:
                    await drone.hears(2)
            case "A drone was lost or stolen":
                assert "1 certificates are revoked" in self.said
                assert await self.is_refused("d1")
                assert "revoked: last d1" in await self.status()
            case "New keys for the server":
                assert re.search(r"certificate of s1: valid until .*, 36[45] days", await self.status())
            case "Back up and restore":
                assert "1 certificates are revoked; services that changed: none" in self.said
            case "Another version of upwash":
                assert await self.is_refused("d1")
        for drone in self.drones:
            await drone.called()

    async def is_refused(self, name: str) -> bool:
        """Whether the drone gets no answer at all."""
        keys = self.machine.folder / "keys"
        dialer = GrpcDialer(name, shown(keys, name), max_message_bytes=10_000)
        link = dialer.dial(self.machine.address, server="s1")
        try:
            await link.request(AVAILABILITY, b"", timeout_s=10.0)
        except Unreachable:
            return True
        finally:
            await link.close()
        return False

    async def status(self) -> str:
        (command,) = {each for _, commands in sections() for each in commands if " status 127" in each}
        printed: str = await asyncio.to_thread(self.machine.run, command)
        return printed


def sections() -> list[tuple[str, list[str]]]:
    """The titles of the page, each with the commands below it that can be run here."""
    found = []
    for part in re.split(r"^##+ ", PAGE, flags=re.MULTILINE)[1:]:
        lines = "".join(re.findall(r"```sh\n(.*?)```", part, re.DOTALL)).splitlines()
        found.append((part.partition("\n")[0], [line for line in lines if not line.startswith(NOT_HERE)]))
    return found


def settings_of_the_page() -> str:
    """The page's configuration, with a service of the operator's own and short leases."""
    settings = "".join(re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)[:1])
    settings = settings.replace('listen = "0.0.0.0:7070"', 'listen = "127.0.0.1:0"\nlease_s = 3')
    settings = settings.replace("instance_ports = [7100, 7119]\n", "")  # others may have these ports
    settings = settings.replace('name = "detector"', 'name = "level"\nprogram = "my_services.py:Level"')
    if not can_sandbox():
        settings = settings.replace('"required"', '"auto"')
    if os.geteuid() == 0:  # as whom the unit does not run it
        settings = settings.replace("sandbox = ", "sandbox_as_root = true\nsandbox = ")
    return settings


@pytest.mark.sandbox
def test_an_operators_day_with_the_commands_of_the_page_costs_no_drone_a_call(machine: Machine) -> None:
    day = Day(machine)
    asyncio.run(day.run())
    for drone in day.drones:
        assert list(dict.fromkeys(drone.answered)) == [1, 2]
    machine.stop()


def can_sandbox() -> bool:
    if shutil.which("bwrap") is None:
        return False
    probe = ["bwrap", "--unshare-all", "--ro-bind", "/", "/", "--proc", "/proc", "true"]
    return subprocess.run(probe, capture_output=True, check=False).returncode == 0


DRONE_UNIT = ROOT / "deploy" / "upwash-drone.service"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
@pytest.mark.parametrize(
    ("unit", "drop_in"), [(UNIT, ""), (UNIT, "upwash-gpu.conf"), (DRONE_UNIT, "")], ids=["", "gpu", "drone"]
)
def test_a_unit_is_understood_by_systemd(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unit: Path, drop_in: str
) -> None:
    installed = tmp_path / unit.name
    there = re.sub(r"/\S+/bin/upwash", "/bin/true", unit.read_text())
    installed.write_text(there.replace("User=pilot", "User=root"))
    if drop_in:
        added = tmp_path / f"{unit.name}.d" / "gpu.conf"
        added.parent.mkdir()
        added.write_text((ROOT / "deploy" / drop_in).read_text())
    monkeypatch.setenv("SYSTEMD_LOG_LEVEL", "warning")
    done = ended(["systemd-analyze", "verify", installed])
    assert (done.returncode, done.stderr) == (0, "")


def test_the_drones_unit_starts_nothing_again_but_a_flight_that_never_began() -> None:
    said = [line for line in DRONE_UNIT.read_text().splitlines() if line.startswith("Restart")]
    assert said == ["Restart=no", f"RestartForceExitStatus={ExitCode.NOT_HEARD:d}", "RestartSec=5"]
    assert "\n".join(said) in (ROOT / "docs" / "small-computers.md").read_text()


# --- the script ---------------------------------------------------------------------------------------------

STUBS = {
    "apt-get": 'echo "apt-get $*" >> "$TOLD"',
    "useradd": 'echo "useradd $*" >> "$TOLD"',
    "python3": """[ "$1" = -c ] && exit "$TOO_OLD"
case $2 in
venv) mkdir -p "$3/bin"; cp "$0" "$3/bin/pip"; cp "$0" "$3/bin/python" ;;
pip) shift 2; echo "pip $*" >> "$TOLD"; echo "#!$0" > "$(dirname "$0")/upwash" ;;
esac""",
}


def install(folder: Path, *arguments: str, too_old: bool = False) -> subprocess.CompletedProcess[str]:
    """Runs the script below a folder, without a package manager, users, or a network."""
    stubs = folder / "stubs"
    stubs.mkdir(exist_ok=True)
    for name, does in STUBS.items():
        (stubs / name).write_text(f"#!/bin/sh\n{does}\n")
        (stubs / name).chmod(0o755)
    path = f"{stubs}:{os.environ['PATH']}"
    return subprocess.run(
        [ROOT / "deploy" / "install.sh", *arguments], cwd=folder, capture_output=True, text=True, timeout=60,
        check=False, env={
            "PATH": path, "DESTDIR": str(folder / "root"), "TOLD": str(folder / "told"), "TOO_OLD": f"{too_old:d}"
        },
    )  # fmt: skip


def test_the_script_installs_a_server_that_can_be_configured_and_changes_nothing_of_that_again(
    tmp_path: Path,
) -> None:
    make_keys(tmp_path / "keys", servers=[["s9"]], drones=["d1"])
    done = install(tmp_path, "s9", "keys")
    assert done.returncode == 0, done.stderr
    root = tmp_path / "root"
    config = read_daemon_config(root / "etc/upwash/server.toml")
    assert [identity.name for identity in config.identities] == ["s9"]
    keys = root / "etc/upwash/keys"
    assert {file.name for file in keys.iterdir()} == {"authority.pem", "revoked.txt", "s9.key", "s9.pem"}
    assert (keys / "s9.key").stat().st_mode & 0o777 == 0o640
    assert (root / "etc/systemd/system/upwash.service").read_text() == UNIT.read_text()
    told = (tmp_path / "told").read_text()
    assert "apt-get install --yes python3-venv bubblewrap" in told
    locked = re.search(
        r"^pip install --upgrade --constraint (.*) .*\[detector,metrics\]$", told, re.MULTILINE
    )
    assert locked is not None and Path(locked[1]).read_text().count("==") > 100

    mine = (root / "etc/upwash/server.toml").read_text().replace("7070", "7171")
    (root / "etc/upwash/server.toml").write_text(mine)
    assert install(tmp_path, "s9", "keys").returncode == 0
    assert (root / "etc/upwash/server.toml").read_text() == mine


def test_what_the_script_makes_below_a_folder_is_for_another_machine(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys", servers=[["s9"]])
    for _ in range(2):  # the second has scripts whose Python is not at its place here
        done = install(tmp_path, "s9", "keys")
        assert done.returncode == 0, done.stderr
        script = tmp_path / "root/opt/upwash/bin/upwash"
        assert script.read_text() == "#!/opt/upwash/bin/python\n"
    assert "useradd" not in (tmp_path / "told").read_text()
    assert "useradd --system" in done.stdout and "chgrp -R upwash /etc/upwash" in done.stdout


def test_an_upgrade_by_the_script_keeps_the_library_for_a_graphics_card(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys", servers=[["s9"]])
    assert install(tmp_path, "s9", "keys").returncode == 0
    installed = tmp_path / "root/opt/upwash/lib/python3.11/site-packages/onnxruntime_gpu-1.20.0.dist-info"
    installed.mkdir(parents=True)
    (tmp_path / "told").unlink()
    assert install(tmp_path, "s9", "keys").returncode == 0
    assert re.search(
        r"^pip install --upgrade .*\[detector-gpu,metrics\]$", (tmp_path / "told").read_text(), re.MULTILINE
    )


def test_one_word_more_installs_what_a_graphics_card_needs_and_keeps_a_configuration(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys", servers=[["s9"]])
    assert install(tmp_path, "s9", "keys", "detector-gpu").returncode == 0
    root = tmp_path / "root"
    file = root / "etc/upwash/server.toml"
    assert read_daemon_config(file).images[0].devices == ("nvidia.com/gpu=all",)
    drop_in = root / "etc/systemd/system/upwash.service.d/gpu.conf"
    assert drop_in.read_text() == (ROOT / "deploy" / "upwash-gpu.conf").read_text()
    told = [line for line in (tmp_path / "told").read_text().splitlines() if line.startswith("pip")]
    assert told[0] == "pip uninstall --yes onnxruntime onnxruntime-gpu"
    assert told[1].endswith("[detector-gpu,metrics]")

    mine = file.read_text().replace('devices = ["nvidia.com/gpu=all"]\n', "")
    file.write_text(mine)
    done = install(tmp_path, "s9", "keys", "detector-gpu")
    assert file.read_text() == mine
    assert f'below its name in {file}: devices = ["nvidia.com/gpu=all"]' in done.stdout

    assert "the third word is detector or detector-gpu" in install(tmp_path, "s9", "keys", "cuda").stderr


def test_a_python_that_is_too_old_is_named_and_gets_nothing(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys", servers=[["s9"]])
    done = install(tmp_path, "s9", "keys", too_old=True)
    assert done.returncode == 1
    assert f"of {tmp_path}/stubs/python3" in done.stdout
    assert "name Python 3.11 or newer in PYTHON" in done.stderr
    assert not (tmp_path / "root").exists()


def test_both_extras_of_the_detector_differ_in_the_library_alone() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    library = {"detector": "onnxruntime>=1.20", "detector-gpu": "onnxruntime-gpu[cuda,cudnn]>=1.21"}
    rest = [[extra for extra in extras[name] if extra != library[name]] for name in library]
    assert rest[0] == rest[1]
    assert len(rest[0]) == len(extras["detector"]) - 1


def test_without_keys_the_script_says_how_to_make_them_and_installs_nothing(tmp_path: Path) -> None:
    done = install(tmp_path, "s9", "keys")
    assert done.returncode == 1
    assert (
        "no keys/authority.pem: make the keys on your own computer, with upwash keys keys --server s9"
        in done.stderr
    )
    assert not (tmp_path / "told").exists()
