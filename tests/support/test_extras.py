"""Every command says in one line which extra to install, where what it imports is not there."""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

from upwash.cli.main import command_line
from upwash.errors import UsageError

ROOT = Path(__file__).parents[2]
THESIS = str(ROOT / "scenarios" / "thesis.toml")

# Found by every Python process below, services' instances too: nothing that an extra brings can be imported.
HIDING = """
import sys

class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {modules}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Hidden())
"""
MODULES = {
    "bag": {"numpy", "rosbags"},
    "campaign": {"distributed"},
    "detector": {"cv2", "numpy", "onnx", "onnxruntime"},
    "discovery": {"ifaddr", "zeroconf"},
    "docker": {"docker", "packaging"},
    "emulation": {"tomli_w"},
    "figures": {"matplotlib"},
    "lxd": {"packaging", "pylxd"},
    "mcap": {"foxglove"},
    "metrics": {"prometheus_client", "uvicorn"},
    "network": {"dbus_fast"},
    "parquet": {"pyarrow"},
    "terrain": {"rasterio"},
    "view": {"starlette", "uvicorn"},
}
DRONE = """
mission.home = { latitude_deg = 39.3666, longitude_deg = 22.9507 }
mission.waypoints_m = [[0, 0]]
autopilot.connection = "tcp:127.0.0.1:1"
[[service]]
name = "detector"
local_call_s = { light = 1.0, heavy = 3.0 }
"""
DAEMON = """
listen = "127.0.0.1:0"
{settings}
[[service]]
name = "detector"
[[server]]
name = "s1"
"""
FILES = {
    "replayed.toml": 'camera.bag = "with"' + DRONE,
    "rendered.toml": "camera.park_seed = 1" + DRONE,
    "filmed.toml": "camera.device = 0" + DRONE,
    "measured.toml": 'metrics = "127.0.0.1:0"\ncamera.folder = "photos"' + DRONE,
    "hilly.toml": 'camera = { folder = "photos", terrain = "hill.tif" }' + DRONE,
    "networked.toml": 'network = { kind = "networkmanager", interfaces = ["wlan1"] }' + DRONE,
    "announced.toml": DAEMON.format(
        settings="""
announce = true
runtime.sandbox_as_root = true
keys = { authority = "keys/authority.pem", certificate = "keys/s1.pem", key = "keys/s1.key" }
"""
    ),
    "found.toml": """
keys = { authority = "keys/authority.pem", certificate = "keys/drone.pem", key = "keys/drone.key" }
camera.folder = "photos"
server = [{ name = "s1", range_m = "measured", address = "mdns", remote_call_s = 0.1 }]
"""
    + DRONE,
    "daemon.toml": DAEMON.format(
        settings="""
metrics = "127.0.0.1:0"
allow_without_certificates = true
runtime.sandbox_as_root = true
"""
    ),
    "containers.toml": DAEMON.format(
        settings="""
runtime.kind = "lxd"
keys = { authority = "keys/authority.pem", certificate = "keys/s1.pem", key = "keys/s1.key" }
"""
    ),
    "docker.toml": DAEMON.format(
        settings="""
runtime.kind = "docker"
allow_without_certificates = true
"""
    ),
    "photos/1.jpg": "",
}
# Each command, and the extra that it needs so; none where it needs none at all.
COMMANDS = [
    ("fly --config rendered.toml", "detector"),
    ("fly --config filmed.toml", "detector"),
    ("fly --config measured.toml", "metrics"),
    ("fly --config hilly.toml", "terrain"),
    ("fly --config rendered.toml --live", "view"),
    ("view with.jsonl", "view"),
    (f"check {THESIS}", ""),
    (f"check {THESIS} --figures figures", "figures"),
    ("check networked.toml --networks", "network"),
    ("check found.toml --servers", "discovery"),
    ("serve --config announced.toml", "discovery"),
    ("serve --config daemon.toml", "metrics"),
    ("serve --config containers.toml", "lxd"),
    ("status 127.0.0.1:1", ""),
    ("keys more --server s2", ""),
    ("serve --config docker.toml", "docker"),
    ("package detector --output images", "lxd"),
    ("package detector --output images --format docker", "docker"),
    ("images --config containers.toml", "lxd"),
    ("images --config docker.toml", "docker"),
    ("profile detector --photos photos", "detector"),
    ("vehicle --listen nowhere", ""),
    ("init project", ""),
    ("demo", "detector"),
    ("demo --live", "detector"),
    ("demo --drones 2", "detector"),
    (f"simulate {THESIS}", ""),
    (f"simulate {THESIS} --figures figures", "figures"),
    ("simulate rendered.toml", "detector"),
    ("report with.jsonl -o page.html", ""),
    ("report with.jsonl --mcap with.mcap", "mcap"),
    ("report with.jsonl --bag with", "bag"),
    ("fly --config replayed.toml", "bag"),
    ("ros --config rendered.toml", ""),
    ("reproduce --seeds 1 --figures figures", "figures"),
    (f"campaign {THESIS} --seeds 1 --cluster 127.0.0.1:1", "campaign"),
    (f"campaign {THESIS} --seeds 1 --out out.parquet", "parquet"),
    ("compare", ""),
    ("explain with.jsonl", ""),
    ("worlds --seeds 2 --out worlds", ""),
    ("traces with.jsonl --out traces", ""),
    ("whatif with.jsonl --draws 2", ""),
    ("chaos --seed 1", ""),
    (f"emulate {THESIS}", "emulation"),
    ("goodput --out table.csv", ""),
]


# Imports what all commands share once, and runs each command that it reads in a process of its own.
FORKING = """
import os, shlex, sys
import upwash.lab.run, upwash.launch.daemon, upwash.launch.flight
from upwash.cli.main import main

for command in sys.stdin:
    if (child := os.fork()) == 0:
        for number, name in enumerate(("printed", "complaint"), start=1):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        sys.exit(main(shlex.split(command)))
    _, status = os.waitpid(child, 0)
    print(os.waitstatus_to_exitcode(status), flush=True)
"""


class Ended(NamedTuple):
    """The exit code of a command, and what it printed."""

    code: int
    printed: str
    complaint: str


Upwash = Callable[[str], Ended]


@pytest.fixture(scope="module")
def upwash(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Upwash]:
    """Runs a command to its end, in a folder with all files that one needs."""
    folder = tmp_path_factory.mktemp("extras")
    (folder / "hiding").mkdir()
    hidden = sorted(set().union(*MODULES.values()))
    (folder / "hiding" / "sitecustomize.py").write_text(HIDING.format(modules=hidden))
    for name, text in FILES.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    path = os.pathsep.join([str(folder / "hiding"), *filter(None, [os.environ.get("PYTHONPATH")])])
    with subprocess.Popen(
        [sys.executable, "-c", FORKING],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as forking:

        def run(command: str) -> Ended:
            assert forking.stdin is not None and forking.stdout is not None
            forking.stdin.write(f"{command}\n")
            forking.stdin.flush()
            code = int(forking.stdout.readline())
            return Ended(code, (folder / "printed").read_text(), (folder / "complaint").read_text())

        for command in ("keys keys --server s1 --drone drone", f"simulate {THESIS} --log with.jsonl"):
            done = run(command)
            assert done.code == 0, done.complaint
        yield run


@pytest.mark.parametrize(("command", "extra"), COMMANDS, ids=[command for command, _ in COMMANDS])
def test_a_command_without_its_extra_says_which_to_install(upwash: Upwash, command: str, extra: str) -> None:
    done = upwash(command)
    assert "Traceback" not in done.complaint
    named = re.findall(r"pip install 'upwash\[(\w+)\]'", done.printed + done.complaint)
    if extra:
        assert done.code == (1 if command.startswith("profile") else 2)  # there it is an instance that fails
        assert set(named) == {extra}
        (said,) = re.findall(r"^upwash: .*", done.complaint, re.MULTILINE)  # beside a daemon's log
        assert re.search(rf"\b({'|'.join(sorted(MODULES[extra]))}) is not installed: ", said)
    else:
        assert not named


def test_each_command_and_each_extra_is_tried() -> None:
    (choices,) = [
        action.choices for action in command_line()._actions if isinstance(action, argparse._SubParsersAction)
    ]
    assert {command.split()[0] for command, _ in COMMANDS} == set(choices)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    # Settings need ncnn (tests/services/test_detector.py), data frames pandas (tests/eventlog/test_log.py), agents
    # gymnasium (below).
    # detector-gpu stands for detector.
    of_commands = set(project["optional-dependencies"]) - {"ncnn", "detector-gpu", "gymnasium", "pandas"}
    assert of_commands == set(MODULES) == {extra for _, extra in COMMANDS if extra}


def test_without_gymnasium_the_environment_names_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "upwash.environment", raising=False)
    with pytest.raises(UsageError, match=r"gymnasium is not installed: `pip install 'upwash\[gymnasium\]'`"):
        import_module("upwash.environment")
