"""Writes the measured parts of pages in docs/: `python -m bench.promises`.

They come from bench/results. Each part stands between two comments that name it; `--chaos FILE` takes up
first what `upwash chaos --out FILE` left, `--reproduction FILE` what `upwash reproduce --json FILE` did.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

import msgspec
from bench.baselines.kept import PARTS as BASELINES
from bench.baselines.kept import Measured, shown
from bench.deployments import HEAD as DEPLOYED
from bench.deployments import Flown as Deployed
from bench.deployments import rows as deployed_rows
from bench.gains.kept import TABLE
from bench.gains.kept import read as read_missions
from bench.gains.tables import Flown
from bench.gains.tables import tables as gained
from bench.load import HEAD, Row, Soak, cells
from bench.peers.order import Comparison
from bench.peers.table import tables
from bench.reproduction import Kept, disagreements, others, sensitivity, shortened, times
from bench.results import FOLDER, Result, leave, read
from bench.sharing import HEAD as SHARED
from bench.sharing import Shared
from bench.sharing import table as shared_rows
from bench.stay_or_go import HEAD as GOING
from bench.stay_or_go import Gained
from bench.stay_or_go import rows as gained_by_going
from bench.validate import COLUMNS, kept, row_of
from bench.weight import Line
from tests.fuzz.campaign import Fuzzed
from tests.system.faults.verdict import Figures
from tests.system.hostile import Attacked

from upwash.lab.faults.display import Summary
from upwash.lab.reproduction.output import decoded

DOCS = Path(__file__).parents[1] / "docs"
PAGES = (
    "promises.md",
    "hostile-input.md",
    "reproduction.md",
    "science.md",
    "fleets.md",
    "calls.md",
)
T = TypeVar("T")
_NOT_YET = "Not measured yet."


def _figures(result: Result, kind: type[T]) -> T:
    return msgspec.convert(result.figures, kind)


def _measured(result: Result) -> str:
    return f"at commit {result.commit} on {result.day}, at a load of {result.load:.1f}"


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
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
        f"flown twice. {broken}\n\nThe longest call took {delay_s:.2f} s of at most {bound_s:.2f} s, with "
        f"its time in line behind other photos; no call left less than {figures.spare_s:.3f} s of its bound "
        f"(0.1 s are the promise's own)."
    )


def _faults(result: Result) -> str:
    figures = _figures(result, Figures)
    delay_s, bound_s = figures.longest_s
    broke = "none broke a promise" if not figures.broken else f"{figures.broken} broke a promise"
    struck = _table(("fault", "times"), figures.strikes.items())
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
            figure.attack,
            f"{figure.usual_s * 1e3:.1f}",
            f"{figure.attacked_s * 1e3:.1f}",
            f"{figure.attacked_s / figure.usual_s:.2f}",
            f"{figure.grown_bytes / 1e6:.1f}",
        )
        for figure in _figures(result, list[Attacked])
    )
    head = ("attack", "usual, ms", "attacked, ms", "ratio", "memory, MB")
    return f"`{result.command}` {_measured(result)}:\n\n{_table(head, rows)}"


def _fuzz(result: Result) -> str:
    figures = _figures(result, list[Fuzzed])
    runs, findings = (sum(getattr(figure, name) for figure in figures) for name in ("runs", "findings"))
    decoders = _table(("decoder", "inputs"), ((figure.harness, f"{figure.runs:,}") for figure in figures))
    return (
        f"`{result.command}` {_measured(result)}: {runs:,} inputs for {len(figures)} decoders, {findings} "
        f"findings.\n\n{decoders}"
    )


def _load(result: Result) -> str:
    rows = map(cells, _figures(result, list[Row]))
    return f"`{result.command}` {_measured(result)}:\n\n{_table(HEAD, rows)}"


def _soak(result: Result) -> str:
    figures = _figures(result, Soak)
    first, *_, last = figures.held
    held = " and ".join(
        f"{each.memory_mb:.1f} MB and {each.descriptors} descriptors after {each.at_s:.0f} s"
        for each in (first, last)
    )
    return (
        f"`{result.command}` {_measured(result)}: {figures.drones} drones, {figures.calls:,} calls in "
        f"{figures.seconds:.0f} s, {figures.failed} failed, p50 {figures.p50_s * 1e3:.0f} ms, "
        f"p99 {figures.p99_s * 1e3:.0f} ms. The daemon and its instance together held {held}."
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
        if "before" not in line.what
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
    seen = list(tables(figures.trials))[::2]  # what was computed, every second one, the command prints
    return "\n\n".join((measured, *seen))


def _times(result: Result) -> str:
    return f"`{result.command}` {_measured(result)}. {times(_figures(result, Kept))}"


def _others(result: Result) -> str:
    return others(_figures(result, Kept))


def _sensitivity(result: Result) -> str:
    return sensitivity(_figures(result, Kept))


def _disagreements(_: Result) -> str:
    return disagreements()


def _gains(result: Result) -> str:
    figures = _figures(result, Flown)
    measured = (
        f"`{result.command}` {_measured(result)}: {figures.missions:,} missions in {figures.worlds} worlds, "
        f"{figures.seeds} seeds, {figures.took_s / 60:.0f} minutes on {figures.cores} cores."
    )
    brief, *_ = gained(read_missions(TABLE)).split("\n\n")
    return f"{measured}\n\n{brief}"


def _baselines(part: str, result: Result) -> str:
    figures = _figures(result, Measured)
    missions = f": {figures.missions:,} missions in {figures.worlds} worlds" if figures.missions else ""
    return f"`{result.command}` {_measured(result)}{missions}.\n\n{shown(part, figures)}"


def _deployments(result: Result) -> str:
    rows = deployed_rows(_figures(result, list[Deployed]))
    return f"`{result.command}` {_measured(result)}, 10 missions each:\n\n{_table(DEPLOYED, rows)}"


def _validation() -> str:
    results = list(kept())
    if not results:
        return _NOT_YET
    measured = ", ".join(sorted({f"{result.commit} on {result.day}" for result, _ in results}))
    rows = (row_of(figures) for _, figures in results)
    return f"{_table(COLUMNS, rows)}\n\nMeasured at commits {measured}."


def _sharing(result: Result) -> str:
    shared = _figures(result, list[Shared])
    rows = []
    for layout in dict.fromkeys(each.layout for each in shared):
        *_, largest = shared_rows(shared, layout)
        rows.append((layout, *largest))
    return f"`{result.command}` {_measured(result)}:\n\n{_table(('the largest fleets', *SHARED), iter(rows))}"


def _stay_or_go(result: Result) -> str:
    rows = gained_by_going(_figures(result, list[Gained]))
    return f"`{result.command}` {_measured(result)}, 30 missions each:\n\n{_table(GOING, rows)}"


PARTS: Mapping[str, Callable[[Result], str]] = {
    "chaos": _chaos,
    "faults": _faults,
    "hostile": _hostile,
    "fuzz": _fuzz,
    "load": _load,
    "soak": _soak,
    "weight": _weight,
    "peers": _peers,
    "reproduction": _times,
    "reproduction_others": _others,
    "reproduction_sensitivity": _sensitivity,
    "reproduction_disagreements": _disagreements,
    "gains": _gains,
    "deployments": _deployments,
    "sharing": _sharing,
    "stay_or_go": _stay_or_go,
    **{f"baselines_{part}": partial(_baselines, part) for part in BASELINES},
}
COLLECTED = {"validation": _validation}  # each from several results


# --- the pages ----------------------------------------------------------------------------------------------


def with_results(page: str) -> str:
    """The page with each measured part as the kept results have it."""

    def written(part: re.Match[str]) -> str:
        name = part["name"]
        return f"<!-- measured: {name} -->\n{_text_of(name)}\n<!-- end -->"

    return re.sub(r"<!-- measured: (?P<name>\w+) -->\n.*?<!-- end -->", written, page, flags=re.DOTALL)


def _text_of(part: str) -> str:
    if part in COLLECTED:
        return COLLECTED[part]()
    result = read(part) or read(part.partition("_")[0])
    return _NOT_YET if result is None else PARTS[part](result)


def main() -> int:
    """Writes the pages, or only looks at them."""
    parser = argparse.ArgumentParser(prog="python -m bench.promises", description=__doc__)
    parser.add_argument(
        "--chaos", type=Path, metavar="FILE", help="take up what `upwash chaos --out FILE` left"
    )
    parser.add_argument(
        "--check", action="store_true", help="write nothing; 1 where a page is not as it would be"
    )
    parser.add_argument(
        "--reproduction",
        type=Path,
        metavar="FILE",
        help="take up what `upwash reproduce --sensitivity --json FILE` left",
    )
    parser.add_argument("--seeds", default="1..100000", metavar="A..B", help="of those worlds")
    options = parser.parse_args()
    if options.chaos:
        summary = msgspec.json.decode(options.chaos.read_bytes(), type=Summary)
        leave(FOLDER / "chaos.json", command=f"upwash chaos --seeds {options.seeds}", figures=summary)
    if options.reproduction:
        results = decoded(options.reproduction.read_bytes())
        leave(
            FOLDER / "reproduction.json", command="upwash reproduce --sensitivity", figures=shortened(results)
        )
    old = {DOCS / name: (DOCS / name).read_text() for name in PAGES}
    stale = [page for page, text in old.items() if with_results(text) != text]
    for page in stale:
        print(f"{page.name}: {'not as the results say' if options.check else 'written'}")
        if not options.check:
            page.write_text(with_results(old[page]))
    print(f"{len(old) - len(stale)} of {len(old)} pages were as the results say")
    return int(options.check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
