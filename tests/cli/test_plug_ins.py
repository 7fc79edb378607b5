"""The plug-ins of docs/plug-ins.md, built and installed as a stranger's, and used through the program."""

from __future__ import annotations

import asyncio
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
import tomli_w
from tests.children import processes
from tests.programs import ROOT, UPWASH, ended, running, write_drone

from upwash.cli.main import main
from upwash.config.daemon import read_daemon_config
from upwash.core.camera.lens import Lens
from upwash.core.geo import Position
from upwash.errors import CameraError, ConfigError, InstanceError
from upwash.launch.cameras import PlugInCamera
from upwash.ports import Handed, InstanceSpec, Photo, Program, ServiceProcess
from upwash.real.instances.runtime import PlugInRuntime

PAGE = ROOT / "docs" / "plug-ins.md"
MOST_LINES = 50
PHOTO = ROOT / "src" / "upwash" / "services" / "models" / "solar_park.jpg"
FLIES = """
from fieldkit.emptiness import Emptiness

def fly(drone):
    emptiness = drone.service(Emptiness)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        emptiness.is_empty(drone.camera.take_photo())
    drone.autopilot.return_home_and_land()
"""


def blocks(language: str) -> list[tuple[str, str]]:
    """Title and text of each block of the page in that language."""
    found = re.findall(rf'```{language}(?: title="([^"]+)")?\n(.*?)```', PAGE.read_text(), re.DOTALL)
    return [(title, text) for title, text in found]


def wheel(source: Path, pyproject: str, **modules: str) -> Path:
    """A wheel of these modules, as its maker builds it."""
    (project,) = re.findall(r'^name = "(.*)"', pyproject, re.MULTILINE)
    package = source / project
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    for name, text in modules.items():
        (package / f"{name}.py").write_text(text)
    (source / "pyproject.toml").write_text(pyproject)
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", "dist"]
    subprocess.run(build, cwd=source, check=True, capture_output=True)
    (built,) = (source / "dist").glob("*.whl")
    return built


def install(built: Path, target: Path) -> None:
    """Installs a wheel into a folder of its own."""
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target"]
    subprocess.run([*pip, target, built], check=True, capture_output=True)


@pytest.fixture(scope="module")
def fieldkit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plug-ins of the page, installed in a folder of their own."""
    source = tmp_path_factory.mktemp("fieldkit")
    modules = {title.removesuffix(".py"): text for title, text in blocks("python")}
    assert max(text.count("\n") for text in modules.values()) <= MOST_LINES
    install(wheel(source, blocks("toml")[0][1], **modules), source / "installed")
    return source / "installed"


class Upwash:
    """Runs commands with this folder among the installations."""

    def __init__(
        self, installed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        self._capsys = capsys
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(installed), str(ROOT / "src")]))
        monkeypatch.setenv("COLUMNS", "250")
        monkeypatch.setattr(sys, "path", [str(installed), *sys.path])

    def __call__(self, *arguments: str | Path) -> tuple[int, str, str]:
        """The exit code, and what was printed."""
        try:
            code = main([str(each) for each in arguments])
        except SystemExit as end:
            code = int(end.code or 0)
        return code, *self._capsys.readouterr()


@pytest.fixture
def upwash(fieldkit: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Upwash:
    return Upwash(fieldkit, monkeypatch, capsys)


Among = Callable[[Path], Upwash]


@pytest.fixture
def among(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Among:
    return lambda installed: Upwash(installed, monkeypatch, capsys)


def installed(folder: Path, distribution: str, entry_points: str, **modules: str) -> Path:
    """The folder, with a distribution that has these modules."""
    described = folder / f"{distribution}-1.0.dist-info"
    described.mkdir(parents=True)
    (described / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\nSummary: tells 100 % of it\n"
    )
    (described / "entry_points.txt").write_text(entry_points)
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text)
    return folder


# --- the plug-ins of the page ---------------------------------------------------------------------------------------


def test_a_command_is_listed_and_runs_as_upwashs_own(upwash: Upwash, logs: tuple[Path, Path]) -> None:
    _, listed, _ = upwash("--help")
    assert re.search(r"^ +hours +Tools for our fields \(of fieldkit 1\.0\)$", listed, re.MULTILINE)
    code, printed, _ = upwash("hours", *logs, "--minutes")
    assert code == 0
    assert re.fullmatch(rf"{logs[0]}: \d+\.\d min\n{logs[1]}: \d+\.\d min\n", printed)
    code, _, complaint = upwash("hours", logs[0].with_name("none.jsonl"))
    assert code == 2
    assert complaint.startswith("upwash: cannot read the event log")


def test_an_export_is_a_file_of_a_report(upwash: Upwash, logs: tuple[Path, Path], tmp_path: Path) -> None:
    file = tmp_path / "flights.md"
    code, _, complaint = upwash("report", *logs, "--export", "table", file)
    assert code == 0, complaint
    head, _, *rows = file.read_text().splitlines()
    assert head == "| flight | minutes | calls |"
    assert [row.split(" | ")[0] for row in rows] == [f"| {log.stem}" for log in logs]
    assert upwash("report", *logs, "--export", "table", "-")[1] == file.read_text()
    code, _, complaint = upwash("report", *logs, "--export", "tables", file)
    assert code == 2
    assert "brings the export 'tables': install one, or name one of: table" in complaint
    before = logs[0].read_bytes()
    assert upwash("report", *logs, "--export", "table", logs[0])[0] == 2
    assert logs[0].read_bytes() == before


def test_a_camera_and_a_service_are_tried_before_the_flight(upwash: Upwash, tmp_path: Path) -> None:
    (tmp_path / "photo.jpg").write_bytes(PHOTO.read_bytes())

    def checked(url: str) -> str:
        camera = {"plug_in": "url", "settings": {"url": url}}
        file = write_drone(tmp_path, FLIES, service=[{"name": "emptiness", "local_call_s": 0.1}])
        document = tomllib.loads(file.read_text()) | {"camera": camera}
        file.write_text(tomli_w.dumps(document))
        return upwash("check", file)[1]

    assert "nothing to warn of" in checked((tmp_path / "photo.jpg").as_uri())
    assert "camera url: its plug-in failed: URLError" in checked((tmp_path / "none.jpg").as_uri())


def test_an_engine_runs_the_instances_of_a_daemon(upwash: Upwash, tmp_path: Path) -> None:
    daemon = (
        'listen = "127.0.0.1:0"\nallow_without_certificates = true\n[runtime]\nkind = "nice"\n'
        'engine.settings = { by = 7 }\n[[service]]\nname = "emptiness"\n[[server]]\nname = "s1"\n'
    )
    (tmp_path / "server.toml").write_text(daemon)
    with running("serve", "--config", "server.toml", folder=tmp_path, stderr=None) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip().removeprefix("s1 ready at ")
        server = {"name": "s1", "address": address, "range_m": 100, "east_m": 0, "north_m": 0}
        drone = write_drone(
            tmp_path,
            service=[{"name": "emptiness", "local_call_s": 0.1}],
            server=[server | {"remote_call_s": 0.1}],
        )
        profile = (
            "profile",
            "emptiness",
            "--config",
            drone,
            "--server",
            "s1",
            "--photos",
            tmp_path / "photos",
        )
        code, printed, complaint = upwash(*profile, "--calls", "2")
        assert code == 0, complaint
        assert "remote_call_s" in printed
        (instance,) = [each.pid for each in processes() if each.parent == process.pid and each.is_instance]
        own, of_instance = (os.getpriority(os.PRIO_PROCESS, each) for each in (process.pid, instance))
        assert of_instance == min(own + 7, 19)


@pytest.mark.usefixtures("upwash")
def test_a_limit_that_an_engine_does_not_enforce_stops_the_daemon(tmp_path: Path) -> None:
    (tmp_path / "server.toml").write_text(
        'listen = "unix:daemon.sock"\nallow_without_certificates = true\n[runtime]\nkind = "nice"\ncpus = 1\n'
        '[[service]]\nname = "emptiness"\n[[server]]\nname = "s1"\n'
    )
    done = ended([*UPWASH, "serve", "--config", tmp_path / "server.toml"])
    assert done.returncode == 2
    assert (
        'cpus of [runtime] would have no effect: the engine of runtime.kind = "nice" does not' in done.stderr
    )


@pytest.mark.usefixtures("upwash")
def test_a_kind_of_runtime_that_nobody_brings_is_a_problem_of_its_key(tmp_path: Path) -> None:
    (tmp_path / "server.toml").write_text(
        'listen = "unix:daemon.sock"\nallow_without_certificates = true\n[runtime]\nkind = "nicer"\n'
        '[[service]]\nname = "emptiness"\n[[server]]\nname = "s1"\n'
    )
    with pytest.raises(
        ConfigError, match=r'"process", or an engine of a plug-in .*\(nice\), found "nicer"'
    ) as refusal:
        read_daemon_config(tmp_path / "server.toml")
    assert refusal.value.key == "runtime.kind"


# --- plug-ins that are not as they should be ------------------------------------------------------------------------

COMMAND = 'ARGUMENTS = {}\ndef run(options):\n    print("it ran")\n'


def test_no_plug_in_replaces_a_command_of_upwash(among: Among, tmp_path: Path) -> None:
    upwash = among(
        installed(tmp_path, "thief", "[upwash.commands]\nkeys = thief\n", thief="raise SystemExit(9)")
    )
    code, printed, _ = upwash("keys", "--help")
    assert code == 0
    assert "authority" in printed
    assert "thief" not in upwash("--help")[1]


def test_a_name_that_two_plug_ins_claim_is_an_error_with_both(among: Among, tmp_path: Path) -> None:
    for each in ("one", "two"):
        installed(tmp_path, each, f"[upwash.commands]\nmap = {each}\n", **{each: COMMAND})
    upwash = among(tmp_path)
    code, printed, complaint = upwash("map")
    assert (code, printed) == (2, "")
    assert (
        complaint == "upwash: the command 'map' is claimed by one 1.0 and by two 1.0: uninstall one of them\n"
    )
    assert "tells 100 % of it (of one 1.0); tells 100 % of it (of two 1.0)" in upwash("--help")[1]


@pytest.mark.parametrize(
    ("module", "why"),
    [
        ("import absent", "cannot be loaded from broken: ModuleNotFoundError: No module named 'absent'"),
        ("1 / 0", "cannot be loaded from broken: ZeroDivisionError"),
        ("raise SystemExit(3)", "cannot be loaded from broken: SystemExit: 3"),
        ("ARGUMENTS = {}", "has no usable ARGUMENTS and run: AttributeError"),
        (
            'ARGUMENTS = {"--to FILE": "a path"}\ndef run(options): ...',
            "has no usable ARGUMENTS and run: TypeError",
        ),
    ],
)
def test_a_broken_plug_in_stops_its_command_alone(
    among: Among, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, why: str
) -> None:
    entries = "[upwash.commands]\nbroken = broken\nwhole = whole\n"
    upwash = among(installed(tmp_path, "kit", entries, broken=module, whole=COMMAND))
    monkeypatch.delitem(sys.modules, "broken", raising=False)
    monkeypatch.delitem(sys.modules, "whole", raising=False)
    code, _, complaint = upwash("broken")
    assert code == 2
    assert re.match(rf"upwash: the command 'broken' (of kit 1\.0 )?{re.escape(why)}", complaint)
    assert upwash("whole")[:2] == (0, "it ran\n")
    assert upwash("--help")[0] == 0


def test_metadata_that_cannot_be_read_takes_nothing_else_down(among: Among, tmp_path: Path) -> None:
    installed(tmp_path, "kit", "[upwash.commands]\nwhole = whole\n", whole=COMMAND)
    torn = installed(tmp_path, "torn", "") / "torn-1.0.dist-info" / "entry_points.txt"
    torn.write_bytes(b"[upwash.commands]\n\xff\xfe = \x00")
    upwash = among(tmp_path)
    assert upwash("whole")[:2] == (0, "it ran\n")
    assert "whole" in upwash("--help")[1]


def test_what_lies_where_the_program_is_started_is_not_installed(
    among: Among, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    upwash = among(installed(tmp_path, "found", "[upwash.commands]\nfound = found\n", found=COMMAND))
    monkeypatch.chdir(tmp_path)
    code, printed, complaint = upwash("found")
    assert (code, printed) == (2, "")
    assert complaint.startswith('upwash: unknown command "found"')


# --- an engine that fails, and a camera in flight -----------------------------------------------------------------


class Full:
    enforces = ()
    is_apart = False

    async def run(self, spec: InstanceSpec, command: Sequence[str], handed: Handed) -> ServiceProcess:
        raise OSError("no room")

    async def close(self) -> None: ...


def test_an_engine_that_fails_is_an_instance_that_does_not_start() -> None:
    runtime = PlugInRuntime(Full(), lambda _: "127.0.0.1:0", max_message_bytes=2**20)
    spec = InstanceSpec("s1", "emptiness", Program("fieldkit.emptiness:Emptiness"))
    with pytest.raises(
        InstanceError, match="emptiness@s1 did not start: its engine failed: OSError: no room"
    ):
        asyncio.run(runtime.start(spec, called=lambda _: None))


class Stuck:
    async def take_photo(self, at: Position) -> Photo:
        await asyncio.sleep(3600.0)
        raise AssertionError


class Plain:
    async def take_photo(self, at: Position) -> Photo:
        return Photo(b"\xff\xd8", 0.0, source="plain")


@pytest.mark.virtual
async def test_a_camera_of_a_plug_in_that_is_silent_fails_in_time() -> None:
    began_s = asyncio.get_running_loop().time()
    with pytest.raises(CameraError, match=r"^camera url: it gave no photo within 20 s$"):
        await PlugInCamera("url", Stuck(), lens=None).take_photo(Position(0.0, 0.0))
    assert asyncio.get_running_loop().time() - began_s == 20.0


@pytest.mark.virtual
async def test_a_photo_of_a_plug_in_has_the_configured_lens() -> None:
    lens = Lens(fov_deg=70.0)
    assert (await PlugInCamera("url", Plain(), lens=lens).take_photo(Position(0.0, 0.0))).lens == lens
