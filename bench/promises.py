"""Writes the measured parts of docs/promises.md, docs/performance.md and docs/peers.md: `python -m bench.promises`.

They come from bench/results. Each part stands between two comments that name it; `--chaos FILE` takes up
first what `upwash chaos --out FILE` left.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import msgspec
from bench.load import Row, Soak
from bench.peers.order import Comparison
from bench.peers.table import tables
from bench.results import FOLDER, Result, leave, read
from bench.weight import Line
from tests.fuzz.campaign import Fuzzed
from tests.system.faults.verdict import Figures
from tests.system.hostile import Attacked

from upwash.lab.chaos_display import Summary

DOCS = Path(__file__).parents[1] / "docs"
PAGES = ("promises.md", "performance.md", "peers.md")
T = TypeVar("T")


def _figures(result: Result, kind: type[T]) -> T:
    return msgspec.convert(result.figures, kind)


def _measured(result: Result) -> str:
    return f"at commit {result.commit} on {result.day}, at a load of {result.load:.1f}"


def _table(head: Sequence[str], rows: Iterator[Sequence[object]]) -> str:
    first, *rest = (f"| {' | '.join(map(str, line))} |" for line in (head, *rows))
    return "\n".join((first, "|---" * len(head) + "|", *rest))


# --- each part ----------------------------------------------------------------------------------------------


def _chaos(result: Result) -> str:
    figures = _figures(result, Summary)
    delay_s, bound_s = figures.longest_s
    if figures.broken:
        seeds = ", ".join(str(each.seed) for each in figures.broken)
        broken = f"A promise was broken in {len(figures.broken)} of them: seeds {seeds}."
    else:
        broken = "No promise was broken."
    return (
        f"`{result.command}` flew {figures.worlds:,} worlds {_measured(result)}: {figures.flights:,} flights "
        f"with {figures.calls:,} calls in {figures.took_s / 60:.1f} minutes; {figures.replayed:,} worlds were "
        f"flown twice. {broken}\n\nThe longest call took {delay_s:.2f} s of at most {bound_s:.2f} s; "
        f"no call left less than {figures.spare_s:.3f} s of its bound, 0.1 s of which are the promise's own."
    )


def _faults(result: Result) -> str:
    figures = _figures(result, Figures)
    delay_s, bound_s = figures.longest_s
    broke = "none broke a promise" if not figures.broken else f"{figures.broken} broke a promise"
    struck = _table(("fault", "times"), ((what, times) for what, times in figures.strikes.items()))
    back = _table(
        ("black-out", "times", "a call at the server again after"),
        (
            (f"{each.lasted_s:.0f} s", each.times, f"{each.soonest_s:.1f} to {each.latest_s:.1f} s")
            for each in figures.returns
        ),
    )
    return (
        f"`{result.command}` {_measured(result)}: {figures.flights} flights of two drones, {broke}. "
        f"Of {figures.calls:,} calls {figures.remote_calls:,} were answered by servers. The longest took "
        f"{delay_s:.2f} s of at most {bound_s:.2f} s; none left less than {figures.spare_s:.3f} s of its bound."
        f"\n\n{back}\n\n{struck}"
    )


def _hostile(result: Result) -> str:
    rows = (
        (
            each.attack,
            f"{each.usual_s * 1e3:.1f}",
            f"{each.attacked_s * 1e3:.1f}",
            f"{each.attacked_s / each.usual_s:.2f}",
            f"{each.grown_bytes / 1e6:.1f}",
        )
        for each in _figures(result, list[Attacked])
    )
    head = ("attack", "usual, ms", "attacked, ms", "ratio", "memory, MB")
    return f"`{result.command}` {_measured(result)}:\n\n{_table(head, rows)}"


def _fuzz(result: Result) -> str:
    rows = (
        (each.harness, f"{each.seconds:.0f} s", f"{each.runs:,}", each.findings)
        for each in _figures(result, list[Fuzzed])
    )
    head = ("decoder", "fuzzed for", "inputs", "findings")
    return f"`{result.command}` {_measured(result)}:\n\n{_table(head, rows)}"


def _load(result: Result) -> str:
    rows = (
        (
            row.drones,
            "bare gRPC" if row.slots is None else f"upwash, {row.slots} slot{'s' * (row.slots > 1)}",
            f"{row.throughput_per_s:.1f}",
            f"{row.p50_s * 1e3:.0f}",
            f"{row.p99_s * 1e3:.0f}",
            row.failed,
            "" if row.slots is None else row.turned_away,
            "" if row.slots is None else row.most_leases,
            f"{row.least_calls} to {row.most_calls}",
        )
        for row in _figures(result, list[Row])
    )
    head = (
        *("drones", "server", "calls/s", "p50, ms", "p99, ms"),
        *("failed", "turned away", "leases at most", "calls of a drone"),
    )
    return f"`{result.command}` {_measured(result)}:\n\n{_table(head, rows)}"


def _soak(result: Result) -> str:
    figures = _figures(result, Soak)
    tenth = max(1, len(figures.held) // 10)
    shown = [figures.held[0], *figures.held[tenth::tenth]]
    rows = ((f"{each.at_s:.0f} s", f"{each.memory_mb:.1f}", each.descriptors) for each in shown)
    table = _table(("after", "memory, MB", "descriptors"), rows)
    return (
        f"`{result.command}` {_measured(result)}: {figures.drones} drones, {figures.calls:,} calls in "
        f"{figures.seconds:.0f} s, {figures.failed} failed, p50 {figures.p50_s * 1e3:.0f} ms, "
        f"p99 {figures.p99_s * 1e3:.0f} ms. The daemon and its instance together:\n\n{table}"
    )


def _weight(result: Result) -> str:
    rows = (
        (
            line.what,
            f"{line.weight.proportional_mb:.1f}",
            f"{line.weight.own_mb:.1f}",
            f"{line.weight.alone_mb:.1f}",
            f"{line.ratio_to_grpc:.2f}",
            f"{line.ratio_to_http:.2f}",
        )
        for line in _figures(result, list[Line])
    )
    head = ("MB, medians", "proportional", "own", "alone", "alone / gRPC client", "alone / HTTP client")
    return f"`{result.command}` {_measured(result)}:\n\n{_table(head, rows)}"


def _peers(result: Result) -> str:
    figures = _figures(result, Comparison)
    versions = ", ".join(f"{name} {version}" for name, version in figures.versions.items())
    measured = (
        f"`{result.command}` {_measured(result)}: {figures.calls} calls, a fault of {figures.fault_s:g} s, "
        f"{figures.at_once} trials at once on {figures.cores} cores, {figures.took_s / 60:.0f} minutes; {versions}."
    )
    return "\n\n".join((measured, *tables(figures.trials)))


PARTS: Mapping[str, Callable[[Result], str]] = {
    "chaos": _chaos,
    "faults": _faults,
    "hostile": _hostile,
    "fuzz": _fuzz,
    "load": _load,
    "soak": _soak,
    "weight": _weight,
    "peers": _peers,
}


# --- the pages ----------------------------------------------------------------------------------------------


def with_results(page: str) -> str:
    """The page with each measured part as the kept results have it."""

    def written(part: re.Match[str]) -> str:
        name = part["name"]
        result = read(name)
        text = "Not measured yet." if result is None else PARTS[name](result)
        return f"<!-- measured: {name} -->\n{text}\n<!-- end -->"

    return re.sub(r"<!-- measured: (?P<name>\w+) -->\n.*?<!-- end -->", written, page, flags=re.DOTALL)


def main() -> None:
    """Writes the pages."""
    parser = argparse.ArgumentParser(prog="python -m bench.promises", description=__doc__)
    parser.add_argument(
        "--chaos", type=Path, metavar="FILE", help="take up what `upwash chaos --out FILE` left"
    )
    parser.add_argument("--seeds", default="1..100000", metavar="A..B", help="of those worlds")
    options = parser.parse_args()
    if options.chaos:
        summary = msgspec.json.decode(options.chaos.read_bytes(), type=Summary)
        leave(FOLDER / "chaos.json", command=f"upwash chaos --seeds {options.seeds}", figures=summary)
    for name in PAGES:
        page = DOCS / name
        page.write_text(with_results(page.read_text()))


if __name__ == "__main__":
    main()
