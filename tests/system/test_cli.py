"""The command line: what it prints, and how it ends, above all when something is wrong."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import socketserver
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.programs import UPWASH, ended, running, upwash

from upwash.cli.main import main

pytestmark = pytest.mark.system

COMMANDS = ("fly", "check", "serve", "status", "keys", "vehicle", "demo")
HEAVY = {"cv2", "numpy", "grpc", "pymavlink", "onnxruntime", "matplotlib", "cryptography", "rich"}

DRONE = """
name = "heron"
[mission]
home = { latitude_deg = 39.3666, longitude_deg = 22.9507 }
waypoints_m = [[0, 0]]
[autopilot]
connection = "tcp:127.0.0.1:1"
[camera]
folder = "photos"
[[service]]
name = "detector"
local_call_s = { light = 1.0, heavy = 3.0 }
[[server]]
name = "s1"
east_m = 0.0
north_m = 0.0
range_m = 50.0
network = "s1-net"
address = "127.0.0.1:7070"
check_s = 3.5
check_running_s = 1.0
remote_call_s = { light = 0.3, heavy = 0.3 }
"""


Ended = subprocess.CompletedProcess[str]
Run = Callable[..., Ended]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs a command to its end in this process, in the test's folder."""

    def run(*arguments: str) -> Ended:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "path", [*sys.path])  # a command adds the folder
        try:
            code = main(arguments)
        except SystemExit as end:
            code = int(str(end.code))
        return Ended(arguments, code, *capsys.readouterr())

    return run


def complaint(ended: Ended, code: int = 2) -> str:
    """The one line that a command which could not do its work says, and nothing else."""
    assert (ended.stdout, ended.returncode) == ("", code), ended.stderr
    assert ended.stderr.startswith("upwash: ")
    assert ended.stderr.count("\n") == 1
    return ended.stderr.removeprefix("upwash: ").strip()


@pytest.fixture
def drone(tmp_path: Path) -> Path:
    """A drone's configuration that can be flown but for its autopilot, which is not there."""
    (tmp_path / "photos").mkdir()
    cv2.imwrite(str(tmp_path / "photos/0.jpg"), np.full((48, 64, 3), 90, np.uint8))
    file = tmp_path / "drone.toml"
    file.write_text(DRONE)
    return file


def loaded_by(code: str) -> set[str]:
    script = f"{code}\nimport sys, json\nprint(json.dumps([name.partition('.')[0] for name in sys.modules]))"
    return set(json.loads(ended([sys.executable, "-c", script]).stdout.splitlines()[-1]))


# --- help and weight ----------------------------------------------------------------------------------------


def test_help_names_every_command() -> None:
    done = upwash("--help")
    assert (done.returncode, done.stderr) == (0, "")
    for command in COMMANDS:
        assert f"\n    {command} " in done.stdout


def test_the_version_is_the_installed_one() -> None:
    assert upwash("--version").stdout == f"upwash {version('upwash')}\n"


def test_the_installed_command_is_the_same() -> None:
    script = Path(sys.executable).with_name("upwash")
    assert ended([script, "--help"]).stdout == upwash("--help").stdout


def test_the_package_and_its_help_load_nothing_heavy() -> None:
    assert not HEAVY & loaded_by("import upwash")
    assert not HEAVY & loaded_by(
        "from upwash.cli.main import main\ntry: main(['--help'])\nexcept SystemExit: pass"
    )


@pytest.mark.parametrize(
    "arguments",
    [
        *("", "fly", "serve", "fly survey --config drone.toml --colour red"),
        *("vehicle --home Volos", "vehicle --home 39.4", "vehicle --home 91,0", "vehicle --home nan,0"),
        *("vehicle --acceleration fast", "vehicle --acceleration nan"),
    ],
)
def test_arguments_that_do_not_fit_are_refused_with_the_usage(arguments: str, run: Run) -> None:
    done = run(*arguments.split())
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("usage: upwash")
    assert "Traceback" not in done.stderr


# --- flying -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mission", "said"),
    [
        ("surwey", "there is no mission 'surwey': the bundled ones are survey"),
        ("missing.py:fly", "missing.py: FileNotFoundError"),
        ("mission.py:land", "there is no land in mission.py"),
        ("mission.py:HEIGHT_M", "is not a function"),
        ("broken.py:fly", "SyntaxError"),
        ("exiting.py:fly", "cannot be loaded from exiting.py"),
    ],
)
def test_a_mission_that_is_not_there_is_named(drone: Path, mission: str, said: str, run: Run) -> None:
    (drone.parent / "mission.py").write_text("HEIGHT_M = 3\n")
    (drone.parent / "broken.py").write_text("def fly(:\n")
    (drone.parent / "exiting.py").write_text("import sys\nsys.exit()\n")
    assert said in complaint(run("fly", mission, "--config", "drone.toml"))


def test_a_mission_may_lie_in_a_module_of_the_current_folder(drone: Path) -> None:
    (drone.parent / "my_mission.py").write_text("HEIGHT_M = 3\n")
    for program in ([str(Path(sys.executable).with_name("upwash"))], UPWASH):
        command = [*program, "fly", "my_mission:HEIGHT_M", "--config", "drone.toml"]
        assert "is not a function" in complaint(ended(command, drone.parent))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[mission]", "[mission", "drone.toml: not valid TOML: "),
        ("range_m", "rangem", "drone.toml: server[0].rangem: "),
        ("range_m = 50.0", "range_m = -1", "drone.toml: server[0].range_m: "),
        ("home = ", "#", "home"),
        ("[autopilot]\nconnection = ", "#", "--autopilot"),
        ("tcp:127.0.0.1:1", "pigeon", "drone.toml: autopilot.connection: expected udpin:"),
        ('folder = "photos"', 'folder = "paintings"', "there is no folder"),
        ('name = "detector"', 'name = "submarine"', "service 'submarine' needs a program"),
        ("127.0.0.1:7070", "10.10.1.1:7070", "server s1 at 10.10.1.1:7070 needs certificates"),
        ("127.0.0.1:7070", "127.example.org:7070", "server s1 at 127.example.org:7070 needs certificates"),
        ('address = "127.0.0.1:7070"', "", "server s1 has no address"),
        ("{ light = 1.0, heavy = 3.0 }", "1.0", "detector"),
    ],
)
def test_a_configuration_that_cannot_be_flown_is_refused_before_anything_starts_and_by_a_check(
    drone: Path, old: str, new: str, said: str, run: Run
) -> None:
    assert old in DRONE
    drone.write_text(DRONE.replace(old, new))
    assert said in complaint(run("fly", "--config", "drone.toml"))
    checked = run("check", "drone.toml")
    assert checked.returncode in (1, 2)
    assert said in " ".join((checked.stdout + checked.stderr).split())


@pytest.mark.parametrize("command", ["fly", "serve"])
@pytest.mark.parametrize("name", ["missing.toml", "."])
def test_a_configuration_that_is_not_there_is_named(command: str, name: str, run: Run) -> None:
    assert complaint(run(command, "--config", name)).startswith(f"{name}: ")


@pytest.mark.parametrize(
    ("authority", "name", "said"),
    [
        ("authority.pem", "stork", "the certificate is for stork, but this drone is called heron"),
        ("other/authority.pem", "heron", "heron.pem: not issued by"),
        ("missing.pem", "heron", "missing.pem: no such file"),
        ("heron.key", "heron", "heron.key: not a PEM certificate"),
    ],
)
def test_a_certificate_that_does_not_fit_is_refused(
    drone: Path, keys: Path, authority: str, name: str, said: str, *, run: Run
) -> None:
    drone.write_text(
        f'{DRONE}[keys]\nauthority = "{keys}/{authority}"\n'
        f'certificate = "{keys}/{name}.pem"\nkey = "{keys}/{name}.key"\n'
    )
    assert said in complaint(run("fly", "--config", "drone.toml"))


@contextlib.contextmanager
def another_programs_port() -> Iterator[str]:
    """The address of something that hangs up on whoever speaks gRPC to it, with a banner of its own."""

    class Banner(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.sendall(b"SSH-2.0-OpenSSH_9.2\r\n")

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Banner) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"127.0.0.1:{server.server_address[1]}"
        server.shutdown()


@pytest.mark.parametrize(("wish", "is_said"), [(None, False), ("INFO", True)])
def test_what_grpc_says_of_a_failed_handshake_is_printed_only_for_who_wants_it(
    keys: Path, monkeypatch: pytest.MonkeyPatch, wish: str | None, is_said: bool
) -> None:
    monkeypatch.delenv("GRPC_VERBOSITY", raising=False)
    if wish:
        monkeypatch.setenv("GRPC_VERBOSITY", wish)
    with another_programs_port() as address:
        done = upwash("status", address, "--server", "s1", "--operator", "heron", "--keys", str(keys))
    assert done.stderr.splitlines()[-1].startswith(f"upwash: s1 at {address}: ")
    assert ("ssl_transport_security" in done.stderr) == is_said
    assert (done.stderr.count("\n") > 1) == is_said


@pytest.mark.usefixtures("drone")
def test_a_log_that_cannot_be_written_is_named(run: Run) -> None:
    said = complaint(run("fly", "--config", "drone.toml", "--log", "drone.toml/log"))
    assert said.startswith("cannot write the event log drone.toml/log: ")


def test_check_says_what_a_configuration_holds_and_what_hurts(drone: Path, keys: Path, run: Run) -> None:
    done = run("check", str(drone))
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith(f"{drone} is understood: 1 waypoint, 1 service, 1 server\n")
    drone.write_text(DRONE + f'[keys]\nauthority = "{keys}/authority.pem"\ncertificate = "no"\nkey = "no"\n')
    done = run("check", str(drone))
    assert done.returncode == 1
    assert "warning: " in done.stdout
    assert str(drone.parent / "no") in done.stdout


def test_check_finds_no_networks_where_none_are_joined(drone: Path, run: Run) -> None:
    done = run("check", str(drone), "--networks")
    assert done.returncode == 2
    assert 'network.kind is "wired", so no network is joined' in done.stderr


@pytest.mark.timeout(90)
def test_an_autopilot_that_is_not_there_is_a_failure(drone: Path) -> None:
    drone.write_text(DRONE.replace("connection =", "found_within_s = 1.0\nconnection ="))
    said = complaint(upwash("fly", "--config", "drone.toml", "--log", "log", folder=drone.parent), code=6)
    assert "tcp:127.0.0.1:1" in said
    assert not [file.name for file in drone.parent.iterdir() if file.suffix == ".sock"]


def test_without_a_command_the_commands_are_listed(run: Run) -> None:
    assert "fly a mission" in run().stderr


# --- a vehicle ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_vehicle_says_where_it_listens_until_it_is_told_to_end(number: signal.Signals) -> None:
    with running("vehicle", "--listen", "udp:127.0.0.1:0", stderr=subprocess.PIPE) as vehicle:
        assert vehicle.stdout is not None
        assert vehicle.stderr is not None
        said, _, address = vehicle.stdout.readline().strip().partition(" ready at udp:")
        assert said == "vehicle"
        assert vehicle.stdout.readline().endswith(f" --autopilot udpout:{address}\n")
        vehicle.send_signal(number)
        assert vehicle.wait(timeout=10.0) == 0
        assert vehicle.stderr.read() == ""


def test_a_vehicle_that_cannot_listen_says_so(run: Run) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert str(port) in complaint(run("vehicle", "--listen", f"tcp:127.0.0.1:{port}"))
    assert "pigeon" in complaint(run("vehicle", "--listen", "pigeon"))


@pytest.mark.parametrize(
    "option",
    [
        *("--acceleration 0", "--armable-after -1", "--speedup 0", "--battery 101"),
        *("--fault engine", "--fault link:9-3"),
    ],
)
def test_a_vehicle_that_could_not_fly_is_refused(option: str, run: Run) -> None:
    assert complaint(run("vehicle", "--listen", "udp:127.0.0.1:0", *option.split()))


# --- keys ---------------------------------------------------------------------------------------------------


def test_keys_prints_the_files_that_it_made_and_only_the_owner_reads_the_keys(
    tmp_path: Path, run: Run
) -> None:
    previous = os.umask(0)
    try:
        done = run("keys", "keys", "--server", "s1,s2", "--drone", "heron", "--drone", "stork")
    finally:
        os.umask(previous)
    assert (done.returncode, done.stderr) == (0, "")
    names = [
        f"{holder}{ending}" for holder in ("authority", "s1", "heron", "stork") for ending in (".pem", ".key")
    ]
    assert done.stdout.splitlines() == [f"keys/{name}" for name in (*names[:2], "revoked.txt", *names[2:])]
    assert (tmp_path / "keys").stat().st_mode & 0o777 == 0o700
    for name in names:
        mode = (tmp_path / "keys" / name).stat().st_mode & 0o777
        assert mode == (0o600 if name.endswith(".key") else 0o644)


def test_keys_says_what_is_left_to_do_with_a_list_and_with_another_authority(
    tmp_path: Path, run: Run
) -> None:
    assert run("keys", "keys", "--drone", "heron").returncode == 0
    for option, file, said in (
        (("--revoke", "heron"), "keys/revoked.txt", "no daemon knows of it yet: copy revoked.txt to each"),
        (("--new-authority",), "keys/authority.pem", "copy authority.pem to every drone and server"),
        (("--drop-former-authorities",), "keys/authority.pem", "as yet they believe the former too"),
    ):
        done = run("keys", "keys", *option)
        assert (done.returncode, done.stdout.splitlines()[0]) == (0, file)
        assert said in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "name at least one --server, --drone or --operator"),
        (("--drone", "../heron"), '"../heron" cannot be a name'),
        (("--drone", ""), '"" cannot be a name'),
        (("--drone", ".."), '".." cannot be a name'),
        (("--server", "s1,,s2"), '"" cannot be a name'),
        (("--server", "s1", "--drone", "s1"), '"s1" is named twice'),
    ],
)
def test_keys_that_cannot_be_made_are_refused(
    tmp_path: Path, arguments: tuple[str, ...], said: str, run: Run
) -> None:
    assert said in complaint(run("keys", "keys", *arguments))
    assert list(tmp_path.iterdir()) == []


INTERRUPTED_IMPORT = """
import sys

class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == "upwash.cli.main":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupts())
from upwash.__main__ import main
sys.exit(main())
"""


def test_a_ctrl_c_before_the_command_is_loaded_ends_it_quietly() -> None:
    done = ended([sys.executable, "-c", INTERRUPTED_IMPORT])
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@pytest.mark.parametrize("verbose", [["-v", "check"], ["check", "--verbose"]])
def test_where_an_error_arose_is_told_to_those_who_ask(drone: Path, verbose: list[str]) -> None:
    (drone.parent / "mine.py").write_text("\n\nimport nothing_of_that_name\n")
    drone.write_text(DRONE.replace("[mission]", '[mission]\nprogram = "mine.py:fly"'))
    done = upwash(*verbose, str(drone))
    assert done.returncode == 2
    assert f'File "{drone.parent / "mine.py"}", line 3' in done.stderr
    last = done.stderr.splitlines()[-1]
    assert complaint(upwash("check", str(drone))) == last.removeprefix("upwash: ").strip()
