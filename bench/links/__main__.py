"""Measures calls over links as operators have them: `python -m bench.links`, as root. See docs/networks.md.

Each link has a daemon and a drone of its own, which know nothing of the link.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from pathlib import Path
from typing import Any

import msgspec
from bench.links.drone import Order, Seen
from bench.links.visit import ROOT, make_ends, visit
from bench.links.wan import Shape, wan
from bench.program import command_line, machine

from upwash.emulation.enclosure import require_root_and_tools, run_enclosed

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
    make_ends()
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
    told = msgspec.json.encode(order).decode()
    with wan(shape):
        said = visit("bench.links.drone", told, service="echo", program="bench.echo:Echo", source=source)
    return msgspec.json.decode(said, type=Seen)


if __name__ == "__main__":
    sys.exit(main())
