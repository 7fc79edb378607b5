"""Flies real programs over real links under faults, and judges what they left: see docs/promises.md.

`python -m tests.system.faults --seeds 0..19` (root) flies each seed's flight in namespaces of its own.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from bench.results import leave
from tests.system.faults.plan import draw
from tests.system.faults.verdict import Verdict, judge, summed_up

from upwash.emulation.enclosure import require_root_and_tools

ROOT = Path(__file__).parents[3]
_RUN = (
    "import sys; from upwash.emulation.enclosure import run_enclosed; sys.exit(run_enclosed(*sys.argv[1:]))"
)


def fly(seed: int, folder: Path) -> Verdict:
    """Flies the flight of that seed, enclosed, and judges it."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "printed").open("wb") as printed:
        command = [sys.executable, "-c", _RUN, "-m", "tests.system.faults.flight", str(seed), str(folder)]
        code = subprocess.run(command, cwd=ROOT, stdout=printed, stderr=printed, check=False).returncode
    if code != 0:
        sys.exit(f"the flight of seed {seed} was not made:\n{(folder / 'printed').read_text()}")
    return judge(folder)


def _seeds(text: str) -> range:
    first, _, last = text.partition("..")
    return range(int(first), int(last or first) + 1)


def told(seed: int, verdict: Verdict) -> Iterator[str]:
    """What is printed of one flight."""
    yield f"seed {seed}: {'BROKEN' if verdict.broken else 'kept'}, in {verdict.record.took_s:.0f} s"
    yield f"  {verdict.calls} calls, {verdict.remote_calls} of them answered by servers"
    delay_s, bound_s = verdict.longest_s
    yield (
        f"  the longest took {delay_s:.2f} s of at most {bound_s:.2f} s; "
        f"none left less than {verdict.spare_s:.3f} s of its bound"
    )
    yield from (f"  {strike.said}" for strike in verdict.record.strikes)
    for each in verdict.returns:
        after = "no call told" if each.after_s is None else f"calls were back after {each.after_s:.2f} s"
        yield f"  {each.strike.said}: {after}"
    yield from (f"  {why}" for why in verdict.broken)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.system.faults", description=__doc__)
    parser.add_argument("--seeds", type=_seeds, default=range(20), help="A..B (default 0..19)")
    parser.add_argument("--at-once", type=int, default=4, help="flights at the same time (default 4)")
    parser.add_argument("--folder", type=Path, help="keeps what the flights leave")
    parser.add_argument("--out", type=Path, help="leaves the figures there as JSON")
    parser.add_argument("--plans", action="store_true", help="only print what would go wrong")
    options = parser.parse_args()
    if options.plans:
        for seed in options.seeds:
            print(f"seed {seed}:", *draw(seed), sep="\n  ")
        return 0
    require_root_and_tools()
    began_s = time.monotonic()
    verdicts = list(_flown(options.seeds, options.folder, at_once=options.at_once))
    broken = sum(bool(verdict.broken) for verdict in verdicts)
    print(f"{len(verdicts)} flights, {broken} with a broken promise, {time.monotonic() - began_s:.0f} s")
    if options.out:
        command = f"python -m tests.system.faults --seeds {options.seeds[0]}..{options.seeds[-1]}"
        leave(options.out, command=command, figures=summed_up(verdicts))
    return broken > 0


def _flown(seeds: range, kept: Path | None, *, at_once: int) -> Iterator[Verdict]:
    """The verdict of each flight, printed as soon as those before it are."""
    with tempfile.TemporaryDirectory() as own, ThreadPoolExecutor(at_once) as pool:
        folder = kept or Path(own)
        for seed, verdict in zip(
            seeds, pool.map(lambda each: fly(each, folder / str(each)), seeds), strict=True
        ):
            print(*told(seed, verdict), sep="\n", flush=True)
            yield verdict


if __name__ == "__main__":
    sys.exit(main())
