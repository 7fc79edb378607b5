"""Compares upwash with simple clients when a server fails: `python -m bench.peers`, as root. See docs/science.md.

Each trial has namespaces, a link and programs of its own. A round makes every trial once, so that other work
of the machine affects all peers alike.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path

import msgspec
from bench.peers.order import FIGURES, SCENARIOS, Comparison, Figures, Order, Peer, Trial, write_order
from bench.peers.programs import last_line
from bench.peers.table import tables
from bench.results import FOLDER, Result, leave

from upwash.emulation.enclosure import require_root_and_tools
from upwash.emulation.namespaces import require_tools

ROOT = Path(__file__).parents[2]
OWN = ROOT / ".venv-peers" / "bin" / "python"  # made by `make bench-peers`
PEERS = (
    Peer(name="`requests`, time-out 2 s", module="http"),
    Peer(name="Pyro5, COMMTIMEOUT 2 s", module="pyro"),
    Peer(name="Dask, `result(2)`", module="dask"),
    Peer(name="gRPC, 2 s, default channel", module="grpc"),
    Peer(name="gRPC tuned by hand", module="grpc_tuned"),
    Peer(name="Ray, `get(timeout=2)`", module="ray"),
    Peer(name="upwash, defaults", module="upwash"),
)
PACKAGES = ("requests", "grpcio", "Pyro5", "distributed", "ray")
_VERSIONS = """
import importlib.metadata, json, sys
found = {each.metadata["Name"].lower(): each.version for each in importlib.metadata.distributions()}
print(json.dumps({name: found[name.lower()] for name in sys.argv[1:] if name.lower() in found}))
"""
_NEEDS = {"http": "requests", "pyro": "Pyro5", "dask": "distributed", "ray": "ray"}
_RUN = (
    "import sys; from upwash.emulation.enclosure import run_enclosed; sys.exit(run_enclosed(*sys.argv[1:]))"
)


def main() -> int:
    """Prints the tables; 1 where a trial failed."""
    options = _options()
    require_root_and_tools()
    require_tools({"nft": "nftables"})
    versions = _versions(options.python) | {"upwash": version("upwash")}
    peers = list(_available(options.peers, options.upwash, versions))
    earlier = _kept(options.add) if options.add else None
    began_s = time.monotonic() - (earlier.took_s if earlier else 0.0)
    trials = [*(earlier.trials if earlier else ()), *_trials(options, peers)]
    comparison = Comparison(
        versions=versions,
        cores=os.cpu_count() or 1,
        at_once=options.at_once,
        calls=options.calls,
        fault_s=options.fault_s,
        took_s=time.monotonic() - began_s,
        trials=trials,
    )
    print(*tables(trials), sep="\n\n")
    print(f"\n{len(trials)} trials in {comparison.took_s:.0f} s")
    if options.out:
        command = f"python -m bench.peers {shlex.join(sys.argv[1:])}".strip()
        leave(options.out, command=command, figures=comparison)
    return any(trial.figures is None for trial in trials)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench.peers", description=__doc__)
    modules = [peer.module for peer in PEERS]
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--first-round", type=int, default=1, help="where some were made before (default 1)")
    parser.add_argument("--add", type=Path, metavar="FILE", help="count the trials that --out left there too")
    parser.add_argument("--scenarios", nargs="+", choices=SCENARIOS, default=SCENARIOS)
    parser.add_argument("--peers", nargs="+", choices=modules, default=modules)
    parser.add_argument("--local", nargs="+", type=float, default=[3.0, 10.0], metavar="SECONDS")
    parser.add_argument("--calls", type=int, default=60)
    parser.add_argument("--fault-s", type=float, default=30.0)
    parser.add_argument("--at-once", type=int, default=7, help="trials at the same time (default 7)")
    parser.add_argument(
        "--upwash",
        action="append",
        default=[],
        metavar="NAME=POLICY",
        help="one more row for upwash, with these keys in [policy]: 'hedged=hedge = { after = \"p95\" }'",
    )
    default = OWN if OWN.exists() else Path(sys.executable)
    parser.add_argument("--python", type=Path, default=default, help="of the peers (default .venv-peers)")
    parser.add_argument("--folder", type=Path, help="keeps what the trials leave")
    parser.add_argument("--out", type=Path, help=f"leave the figures there as JSON: {FOLDER.name}/peers.json")
    return parser.parse_args()


def _kept(file: Path) -> Comparison:
    return msgspec.convert(msgspec.json.decode(file.read_bytes(), type=Result).figures, Comparison)


def _versions(python: Path) -> dict[str, str]:
    said = subprocess.run((python, "-c", _VERSIONS, *PACKAGES), capture_output=True, check=True).stdout
    return msgspec.json.decode(said, type=dict[str, str])


def _available(modules: Sequence[str], policies: Sequence[str], versions: dict[str, str]) -> Iterator[Peer]:
    for peer in PEERS:
        needs = _NEEDS.get(peer.module)
        if peer.module not in modules:
            continue
        if needs and needs not in versions:
            print(f"left out: {peer.name}, as {needs} is not installed: make bench-peers", flush=True)
            continue
        yield peer
    for each in policies:
        name, _, policy = each.partition("=")
        yield Peer(name=f"upwash, {name}", module="upwash", policy=policy.strip())


def _trials(options: argparse.Namespace, peers: Sequence[Peer]) -> Iterator[Trial]:
    """Every trial in its turn, told as it ends."""
    with (
        tempfile.TemporaryDirectory(prefix="peers-") as own,
        ThreadPoolExecutor(options.at_once) as pool,
    ):
        orders = [
            Order(
                peer=peer,
                python=str(options.python.absolute()),
                scenario=scenario,
                local_s=local_s,
                calls=options.calls,
                fault_s=options.fault_s,
                round=number,
                folder=(options.folder or Path(own)).absolute() / f"{number}-{scenario}-{local_s:g}-{place}",
            )
            for number in range(options.first_round - 1, options.first_round - 1 + options.rounds)
            for scenario in options.scenarios
            for local_s in options.local
            for place, peer in enumerate(peers)
        ]
        for trial in pool.map(_made, orders):
            print(_told(trial), flush=True)
            yield trial


def _made(order: Order) -> Trial:
    order.folder.mkdir(parents=True)
    file, printed = order.folder / "order.json", order.folder / "printed"
    write_order(file, order)
    with printed.open("wb") as said:
        command = (sys.executable, "-c", _RUN, "-m", "bench.peers.trial", str(file))
        code = subprocess.run(command, cwd=ROOT, stdout=said, stderr=said, check=False).returncode
    left = order.folder / FIGURES
    figures = msgspec.json.decode(left.read_bytes(), type=Figures) if left.exists() else None
    return Trial(
        peer=order.peer.name,
        scenario=order.scenario,
        local_s=order.local_s,
        round=order.round,
        figures=figures,
        why="" if figures else last_line(printed) or f"ended with {code}",
    )


def _told(trial: Trial) -> str:
    what = f"{trial.peer}, {trial.scenario}, {trial.local_s:g} s, round {trial.round + 1}:"
    if trial.figures is None:
        return f"{what} failed: {trial.why}"
    figures = trial.figures
    raised = f", raised {figures.raised[0]}" if figures.raised else ""
    remote = "no answer" if figures.remote_s is None else f"{figures.remote_s:.3f} s"
    took = f"{figures.total_s:.1f} s, longest {figures.longest_s:.1f} s"
    return f"{what} {took}, at the server {remote}{raised}"


if __name__ == "__main__":
    sys.exit(main())
