"""Measures calls over links as operators have them: `python -m bench.links`, as root. See docs/links.md.

Each link has a daemon and a drone of its own, which know nothing of the link.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import msgspec
from bench.links.drone import Order, Seen
from bench.links.wan import DRONE, SERVER, Shape, wan
from bench.program import command_line, machine

from upwash.emulation.enclosure import require_root_and_tools, run_enclosed, settle_in
from upwash.emulation.namespaces import inside, make_namespace
from upwash.real.trust.authority import make_keys

ROOT = Path(__file__).parents[2]
ADDRESS = f"{SERVER.address}:7070"
ROUND_TRIPS_S = (0.05, 0.2, 0.5, 1.0)
LINKS: dict[str, dict[str, Any]] = {
    "0.5 Mbit/s": {"rate_bit_s": 0.5e6},
    "5 Mbit/s": {"rate_bit_s": 5e6},
    "54 Mbit/s": {"rate_bit_s": 54e6},
    "5 Mbit/s, MTU 1,280": {"rate_bit_s": 5e6, "mtu": 1280},
    "5 Mbit/s, 5 % lost": {"rate_bit_s": 5e6, "loss": 0.05},
}
HOLE: dict[str, Any] = {"rate_bit_s": 5e6, "largest_bytes": 1280}  # an MTU without "packet too big" messages
ORDER = Order(calls=20, photo_bytes=20_000, deadline_s=10.0, checks=3)
SERVER_TOML = """\
listen = "{address}"
runtime = {{ sandbox = "off" }}
keys = {{ authority = "{keys}/authority.pem", certificate = "{keys}/s1.pem", key = "{keys}/s1.key" }}
[[service]]
name = "echo"
program = "bench.echo:Echo"
[[server]]
name = "s1"
"""


def main() -> int:
    """Prints the table; 1 where the enclosed program failed."""
    options = _options()
    if options.enclosed:
        return _measure(options)
    require_root_and_tools()
    return run_enclosed("-m", "bench.links", "--enclosed", *sys.argv[1:])


def _options() -> argparse.Namespace:
    parser = command_line("links", __doc__)
    parser.add_argument("--calls", type=int, default=ORDER.calls)
    parser.add_argument("--src", type=Path, default=ROOT / "src", help="upwash as it was, to compare")
    parser.add_argument("--enclosed", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


def _measure(options: argparse.Namespace) -> int:
    order = msgspec.structs.replace(ORDER, calls=2 if options.quick else options.calls)
    settle_in(lambda: os._exit(1))
    for end in (DRONE, SERVER):
        make_namespace(end.namespace)
    print(f"{order.calls} calls of {order.photo_bytes:,} bytes, {order.deadline_s:g} s each; {machine()}\n")
    links = dict([*LINKS.items()][:1]) if options.quick else LINKS
    print("| round trip |", " | ".join(links), "|")
    print("|---" * (1 + len(links)) + "|")
    for round_trip_s in ROUND_TRIPS_S[-1:] if options.quick else ROUND_TRIPS_S:
        cells = [
            _cell(Shape(round_trip_s=round_trip_s, **link), order, options.src) for link in links.values()
        ]
        print(f"| {1000 * round_trip_s:,.0f} ms | " + " | ".join(cells) + " |", flush=True)
    print(f"\npackets above 1,280 bytes lost: {_cell(Shape(round_trip_s=0.05, **HOLE), order, options.src)}")
    return 0


def _cell(shape: Shape, order: Order, source: Path) -> str:
    seen = visited(shape, order, source)
    if seen.ready_s is None:
        return f"never ready: {seen.failure}"
    share = f"{len(seen.delays_s)} of {order.calls}"
    took = f" in {statistics.median(seen.delays_s):.2f} s" if seen.delays_s else ""
    return f"{share}{took}, ready after {seen.ready_s:.1f} s{f' ({seen.failure})' if seen.failure else ''}"


def visited(shape: Shape, order: Order, source: Path = ROOT / "src") -> Seen:
    """What a drone sees of a server at the other end of that link, by the upwash of that source folder."""
    environment = os.environ | {"PYTHONPATH": f"{source}{os.pathsep}{ROOT}"}
    with tempfile.TemporaryDirectory() as folder, wan(shape):
        keys = Path(folder, "keys")
        make_keys(keys, servers=[["s1"]], drones=["drone"], operators=[])
        Path(folder, "server.toml").write_text(SERVER_TOML.format(address=ADDRESS, keys=keys))
        serve = [sys.executable, "-m", "upwash", "serve", "--config", f"{folder}/server.toml"]
        with subprocess.Popen(
            [*inside(SERVER.namespace), *serve],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            text=True,
        ) as daemon:
            try:
                assert daemon.stdout is not None
                assert daemon.stdout.readline() == f"s1 ready at {ADDRESS}\n"
                drone = [sys.executable, "-m", "bench.links.drone", str(keys), ADDRESS]
                said = subprocess.run(
                    [*inside(DRONE.namespace), *drone, msgspec.json.encode(order).decode()],
                    stdout=subprocess.PIPE,
                    env=environment,
                    check=True,
                ).stdout
            finally:
                daemon.terminate()
    return msgspec.json.decode(said, type=Seen)


if __name__ == "__main__":
    sys.exit(main())
