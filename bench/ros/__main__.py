"""A call over ROS 2 as a bare service, in FogROS2's way, and by `upwash ros`: `python -m bench.ros`, as root.

All three share a radio of 54 Mbit/s. On a good link they take turns. With 5 % of the frames lost each way they make
calls apart, given up after 10 s. Through a black-out they run side by side. See docs/ros.md.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bench.peers.link import DRONE, SERVER, dark, make_link
from bench.results import leave

from upwash.emulation.enclosure import require_root_and_tools, run_enclosed, settle_in
from upwash.emulation.namespaces import command, inside, require_tools
from upwash.real.trust.authority import make_keys

ROOT = Path(__file__).parents[2]
OWN = ROOT / ".venv-ros" / "bin" / "python"  # made by `make test-ros`
_SETTLED_S = 8.0  # what was lost has been sent again
WAYS = {"service": "bare ROS 2 service", "topics": "FogROS2's way", "upwash": "`upwash ros`"}
# Each frame may be lost, also one of a datagram's fragments, as netem has it; the input hook sees whole datagrams.
LOSS = """\
table netdev lossy {
    chain in {
        type filter hook ingress device "radio" priority 0
        numgen random mod 100 < 5 drop
    }
}
"""
SERVICE = """
[[service]]
name = "looker"
program = "looker.py:Looker"
"""
LOOKER = """
from upwash import service

@service
class Looker:
    def look(self, photo: bytes) -> int:
        return len(photo)
"""
DAEMON = (
    """\
listen = "{address}:7070"
runtime = {{ sandbox = "off" }}
keys = {{ authority = "keys/authority.pem", certificate = "keys/s1.pem", key = "keys/s1.key" }}
server = [{{ name = "s1" }}]
"""
    + SERVICE
)
NODE = (
    """\
keys = {{ authority = "keys/authority.pem", certificate = "keys/drone.pem", key = "keys/drone.key" }}
"""
    + SERVICE
    + """\
local_call_s = {local_s}
local_pace_s = {local_s}
request_bytes = 430_000

[[server]]
name = "s1"
address = "{address}:7070"
range_m = "measured"
remote_call_s = 0.1
check_s = 2
check_running_s = 1
"""
)


def main() -> int:
    """Makes the comparison in an enclosure of its own, or, inside, prints the table."""
    options = _options()
    if not options.enclosed:
        require_root_and_tools()
        require_tools({"nft": "nftables"})
        return run_enclosed("-m", "bench.ros", "--enclosed", *sys.argv[1:])
    settle_in(lambda: os._exit(1))
    samples, dark_s = _measured(options)
    figures = {scenario: _figures(samples[scenario], dark_s) for scenario in samples}
    print(*_table(figures), sep="\n")
    if options.out:
        words = [word for word in sys.argv[1:] if word != "--enclosed"]
        leave(options.out, command=f"python -m bench.ros {' '.join(words)}".strip(), figures=figures)
    return 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", type=Path, default=OWN, help="the Python that has ROS 2")
    parser.add_argument(
        "--turns", type=int, default=30, help="calls of each way on a good link; a third with loss"
    )
    parser.add_argument("--dark-s", type=float, default=30.0, help="the black-out")
    parser.add_argument("--around-s", type=float, default=20.0, help="before and after it")
    parser.add_argument("--local-s", type=float, default=1.0, help="a call on the drone")
    parser.add_argument("--out", type=Path, help="a file for the figures")
    parser.add_argument("--quick", action="store_true", help="a few calls and seconds")
    parser.add_argument("--enclosed", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.quick:
        options.turns, options.dark_s, options.around_s = 2, 3.0, 3.0
    return options


def _measured(options: argparse.Namespace) -> tuple[dict[str, list[dict[str, Any]]], tuple[float, float]]:
    make_link()
    folder = Path("/run/tmp/ros")
    folder.mkdir()
    (folder / "looker.py").write_text(LOOKER)
    make_keys(folder / "keys", servers=[["s1"]], drones=["drone"])
    (folder / "server.toml").write_text(DAEMON.format(address=SERVER.address))
    (folder / "drone.toml").write_text(NODE.format(address=SERVER.address, local_s=options.local_s))
    python, nodes = str(options.python.absolute()), ("-m", "bench.ros.nodes")
    lasts_s = 2 * options.around_s + options.dark_s
    with contextlib.ExitStack() as stack:
        for end, words in (
            (SERVER, (sys.executable, "-m", "upwash", "serve", "--config", "server.toml")),
            (SERVER, (python, *nodes, "server", DRONE.address)),
        ):
            process = stack.enter_context(_started(end.namespace, words, folder))
            assert process.stdout is not None and "ready" in process.stdout.readline()
        began_s = time.monotonic()
        node = stack.enter_context(
            _started(DRONE.namespace, (python, "-m", "upwash", "ros", "--config", "drone.toml"), folder)
        )
        _wait_for(folder, "local_ready")
        print(f"`upwash ros` was ready after {time.monotonic() - began_s:.1f} s", end=", ")
        drone = stack.enter_context(
            _started(
                DRONE.namespace,
                (python, *nodes, "drone", SERVER.address, str(options.turns), str(lasts_s), "2.0"),
                folder,
            )
        )
        list(_told(drone, "ready"))
        print(f"and had {_resident_mb(node.pid):.0f} MB when calls began")
        samples = {"good link": _asked(drone, "turns", "good")}
        samples["5 % lost"] = []
        for way in reversed(WAYS):  # apart, as what the others send again fills the radio
            with _lossy():
                samples["5 % lost"] += _asked(drone, way, "lossy")
            time.sleep(_SETTLED_S)
        assert drone.stdin is not None
        drone.stdin.write("at_once dark\n")
        drone.stdin.flush()
        time.sleep(options.around_s)
        from_s = time.monotonic()
        with dark():
            time.sleep(options.dark_s)
        dark_s = from_s, time.monotonic()
        samples["black-out"] = list(_told(drone, "over"))
    return samples, dark_s


def _wait_for(folder: Path, event: str) -> None:
    """Returns once the node's log has the event."""
    while not any(event in log.read_text() for log in folder.glob("runs/*/events.jsonl")):
        time.sleep(0.02)


def _resident_mb(process: int) -> float:
    """The memory of the process, which `ip netns exec` has become; not that of its services."""
    (line,) = [
        line for line in Path(f"/proc/{process}/status").read_text().splitlines() if line.startswith("VmRSS")
    ]
    return int(line.split()[1]) / 1024


@contextlib.contextmanager
def _lossy() -> Iterator[None]:
    for end in (DRONE, SERVER):
        subprocess.run([*inside(end.namespace), "nft", "-f", "-"], input=LOSS, text=True, check=True)
    try:
        yield
    finally:
        for end in (DRONE, SERVER):
            command(*inside(end.namespace), "nft", "delete", "table", "netdev", "lossy")


@contextlib.contextmanager
def _started(namespace: str, words: Sequence[str], folder: Path) -> Iterator[subprocess.Popen[str]]:
    path = os.pathsep.join([str(ROOT), str(ROOT / "src"), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": path, "ROS_DOMAIN_ID": "13"}
    if words[-3:-1] == ("ros", "--config"):
        environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with subprocess.Popen(
        (*inside(namespace), *words),
        cwd=folder,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGKILL)


def _asked(drone: subprocess.Popen[str], how: str, name: str) -> list[dict[str, Any]]:
    assert drone.stdin is not None
    drone.stdin.write(f"{how} {name}\n")
    drone.stdin.flush()
    return list(_told(drone, "over"))


def _told(drone: subprocess.Popen[str], until: str) -> Iterator[dict[str, Any]]:
    assert drone.stdout is not None
    for line in drone.stdout:
        said = json.loads(line)
        if said["what"] == until:
            return
        yield said
    raise RuntimeError("the drone's program ended early")


def _figures(samples: Sequence[dict[str, Any]], dark_s: tuple[float, float]) -> dict[str, Any]:
    found = {}
    for way in WAYS:
        own = [sample for sample in samples if sample["way"] == way]
        answered = [sample for sample in own if sample["place"] is not None]
        took_s = sorted(sample["took_s"] for sample in answered)
        back_s = [
            sample["began_s"] + sample["took_s"] - dark_s[1]
            for sample in answered
            if sample["place"] == "server" and sample["began_s"] + sample["took_s"] > dark_s[1]
        ]
        found[way] = {
            "calls": len(own),
            "answered": len(answered),
            "by_drone": sum(sample["place"] == "drone" for sample in answered),
            "median_s": statistics.median(took_s) if took_s else None,
            "p95_s": took_s[min(len(took_s) - 1, int(0.95 * len(took_s)))] if took_s else None,
            "longest_s": max((sample["took_s"] for sample in own), default=None),
            "back_s": min(back_s, default=None),
        }
    return found


def _table(figures: dict[str, dict[str, Any]]) -> Iterator[str]:
    yield "| link | way | median | of the bare call | 95 % | longest | answered | by the drone | back after |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for scenario, of_ways in figures.items():
        bare_s = of_ways["service"]["median_s"]
        for way, own in of_ways.items():
            ratio = f"{own['median_s'] / bare_s:.2f}" if own["median_s"] and bare_s else ""
            back = _seconds(own["back_s"]) if scenario == "black-out" else ""
            yield (
                f"| {scenario} | {WAYS[way]} | {_seconds(own['median_s'])} | {ratio} | {_seconds(own['p95_s'])} "
                f"| {_seconds(own['longest_s'])} | {own['answered']} of {own['calls']} | {own['by_drone']} | {back} |"
            )


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.3f} s" if value < 1 else f"{value:.1f} s"


if __name__ == "__main__":
    sys.exit(main())
