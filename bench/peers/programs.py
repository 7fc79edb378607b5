"""The programs of a trial: a peer's server, which can be killed, stopped and started again, and its client."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from bench.peers.link import DRONE, SERVER
from bench.peers.order import Order
from tests.children import children

from upwash.emulation.namespaces import command, inside
from upwash.launch.processes import ready_program
from upwash.real.trust.authority import make_keys

ROOT = Path(__file__).parents[2]
PORT = 7070
ADDRESS = f"{SERVER.address}:{PORT}"
REQUEST_BYTES = 430_000
HOME = "39.3666,22.9507"
DAEMON = """\
listen = "{address}"
runtime = {{ sandbox_as_root = true }}
keys = {{ authority = "keys/authority.pem", certificate = "keys/s1.pem", key = "keys/s1.key" }}
server = [{{ name = "s1" }}]

[[service]]
name = "looker"
program = "bench.peers.by_upwash:Looker"
settings = {{ place = "server", folder = "{folder}" }}
"""
FLIGHT = """\
keys = {{ authority = "keys/authority.pem", certificate = "keys/drone.pem", key = "keys/drone.key" }}
network = {{ kind = "wired" }}
camera = {{ folder = "photos" }}
autopilot = {{ connection = "{vehicle}" }}
policy = {{ {policy} }}

[mission]
program = "bench.peers.by_upwash:mission"
home = {{ latitude_deg = 39.3666, longitude_deg = 22.9507 }}
waypoints_m = [[0, 0]]

[[service]]
name = "looker"
program = "bench.peers.by_upwash:Looker"
settings = {{ place = "drone", folder = "{folder}" }}
local_call_s = {local_s}
local_pace_s = {local_s}
request_bytes = {request_bytes}

[[server]]
name = "s1"
east_m = 0.0
north_m = 0.0
range_m = 100.0
network = "s1-net"
address = "{address}"
bandwidth_bit_s = 54e6
processing_s = 0.6
"""


class Server:
    """A peer's server: every process of its computer."""

    def __init__(self, order: Order) -> None:
        self._command = _serving(order)
        self._environment = _environment(order)
        self._log = order.folder / "server.log"
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Returns once it says that it is ready."""
        with self._log.open("a") as log:
            self._process = subprocess.Popen(
                (*inside(SERVER.namespace), *self._command),
                cwd=ROOT,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        assert self._process.stdout is not None
        if "ready" not in self._process.stdout.readline():
            raise RuntimeError(f"the server did not start: {last_line(self._log)}")

    def kill(self) -> None:
        """Ends all of it at once."""
        self.signal(signal.SIGKILL)
        assert self._process is not None
        self._process.wait()

    def signal(self, number: signal.Signals) -> None:
        """Sends it to every process."""
        here = {int(process) for process in command("ip", "netns", "pids", SERVER.namespace).split()}
        for process in here | {below for each in here for below in _below(each)}:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, number)


@contextlib.contextmanager
def started_client(order: Order) -> Iterator[subprocess.Popen[bytes]]:
    """The drone's program, which ends when its calls are made."""
    with contextlib.ExitStack() as stack:
        words = _flying(order, stack)
        with (order.folder / "drone.log").open("wb") as log:
            process = subprocess.Popen(
                (*inside(DRONE.namespace), *words),
                cwd=ROOT,
                env=_environment(order),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        try:
            yield process
        finally:
            process.kill()
            process.wait()


def why_ended(order: Order) -> str:
    """The last line of the drone's program."""
    return last_line(order.folder / "drone.log")


def prepare(order: Order) -> None:
    """Writes the files that upwash needs."""
    if order.peer.module != "upwash":
        return
    folder = order.folder
    make_keys(folder / "keys", servers=[["s1"]], drones=["drone"])
    (folder / "photos").mkdir()
    (folder / "photos" / "photo.jpg").write_bytes(os.urandom(REQUEST_BYTES))
    (folder / "server.toml").write_text(DAEMON.format(address=ADDRESS, folder=_seen(order)))


def _serving(order: Order) -> tuple[str, ...]:
    if order.peer.module == "upwash":
        return (sys.executable, "-m", "upwash", "serve", "--config", str(order.folder / "server.toml"))
    return (order.python, "-m", "bench.peers.server", order.peer.module, ADDRESS, str(_seen(order)))


def _flying(order: Order, stack: contextlib.ExitStack) -> tuple[str, ...]:
    if order.peer.module != "upwash":
        facts = (ADDRESS, str(_seen(order)), str(order.local_s), str(order.calls))
        return (order.python, "-m", "bench.peers.drone", order.peer.module, *facts)
    vehicle = stack.enter_context(
        ready_program(
            "vehicle",
            order.folder,
            *("vehicle", "--listen", "udp:127.0.0.1:0", "--home", HOME, "--armable-after", "1"),
            through=inside(DRONE.namespace),
        )
    )
    _, host, port = vehicle.split(":")
    (order.folder / "drone.toml").write_text(
        FLIGHT.format(
            vehicle=f"udpout:{host}:{port}",
            policy=order.peer.policy,
            folder=_seen(order),
            local_s=order.local_s,
            request_bytes=REQUEST_BYTES,
            address=ADDRESS,
        )
    )
    files = ("--config", str(order.folder / "drone.toml"), "--log", str(order.folder / "events.jsonl"))
    return (sys.executable, "-m", "upwash", "fly", *files)


def _seen(order: Order) -> Path:
    """The folder that every program of the trial sees, a sandbox included."""
    return order.folder / "seen"


def _environment(order: Order) -> Mapping[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.lower().endswith("_proxy")}
    return {
        **kept,
        "PYTHONPATH": os.pathsep.join((str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")]))),
        "PEERS_FOLDER": str(_seen(order)),
        "PEERS_CALLS": str(order.calls),
    }


def _below(process: int) -> Iterator[int]:
    for child in children(process):
        yield child
        yield from _below(child)


def last_line(file: Path) -> str:
    """What a program said last, empty where it said nothing."""
    lines = [line for line in file.read_text(errors="replace").splitlines() if line.strip()]
    return lines[-1][:300] if lines else ""
