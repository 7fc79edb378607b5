"""A drone program at one end of an emulated link, and a daemon at the other end. Neither knows the link."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from bench.links.wan import ADDRESS, DRONE, SERVER

from upwash.emulation.enclosure import settle_in
from upwash.emulation.namespaces import inside, make_namespace
from upwash.real.trust.authority import make_keys

ROOT = Path(__file__).parents[2]
_SERVER_TOML = """\
listen = "{address}"
runtime = {{ sandbox = "off" }}
max_message_bytes = 33_554_432
keys = {{ authority = "{keys}/authority.pem", certificate = "{keys}/s1.pem", key = "{keys}/s1.key" }}
[[service]]
name = "{service}"
program = "{program}"
[[server]]
name = "s1"
"""


def make_ends() -> None:
    """Makes the namespaces of both ends, in the enclosed program."""
    settle_in(lambda: os._exit(1))
    for end in (DRONE, SERVER):
        make_namespace(end.namespace)


def visit(*drone: str, service: str, program: str, source: Path = ROOT / "src") -> bytes:
    """What `python -m DRONE... KEYS` prints while a daemon serves the program; `source` has their upwash."""
    environment = os.environ | {"PYTHONPATH": f"{source}{os.pathsep}{ROOT}"}
    with tempfile.TemporaryDirectory() as keys:
        make_keys(Path(keys), servers=[["s1"]], drones=["drone"])
        config = Path(keys, "server.toml")
        config.write_text(_SERVER_TOML.format(address=ADDRESS, keys=keys, service=service, program=program))
        with subprocess.Popen(
            [*inside(SERVER.namespace), sys.executable, "-m", "upwash", "serve", "--config", config],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            text=True,
        ) as daemon:
            try:
                assert daemon.stdout is not None
                assert daemon.stdout.readline() == f"s1 ready at {ADDRESS}\n"
                return subprocess.run(
                    [*inside(DRONE.namespace), sys.executable, "-m", *drone, keys],
                    stdout=subprocess.PIPE,
                    env=environment,
                    check=True,
                ).stdout
            finally:
                daemon.terminate()
