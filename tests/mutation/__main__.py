"""Plants defects in packages, one at a time, and counts those that the packages' tests find.

    python -m tests.mutation                    # 40 defects in each package of PACKAGES
    python -m tests.mutation core rpc --count 100 --seed 2 --workers 2

The defects are drawn by the seed, so that a score can be compared with an earlier one. A survivor is a defect that no
test of the package finds: write the test, or enter the defect into `argued.txt` with the reason why it does no harm.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from tests.mutation.mutants import Mutant, mutants_of

ROOT = Path(__file__).parents[2]
ARGUED = Path(__file__).with_name("argued.txt")
PACKAGES = {  # the tests that judge a package; those that fail soonest come first
    "core": ("tests/core", "tests/drone", "tests/sim", "tests/lab"),
    "drone": ("tests/drone", "tests/sim", "tests/lab", "tests/launch"),
    "rpc": ("tests/rpc", "tests/fuzz", "tests/ports/test_link.py", "tests/server"),
    "server": ("tests/server", "tests/sim", "tests/lab", "tests/launch"),
    "real/mavlink": ("tests/ports", "tests/sim", "tests/fuzz"),
}
_TIMES_AS_LONG = 4  # as without a defect: then the program hangs, which is a way to find the defect
_ROUNDS_S = 30


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of one mutant: `survived`, or found by that test."""

    mutant: Mutant
    found_by: str
    took_s: float


class Tree:
    """A copy of the sources in which one defect is planted at a time; everything else is the repository's."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        for entry in ROOT.iterdir():
            if entry.name == "src":
                shutil.copytree(entry, folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
            elif not entry.name.startswith((".git", ".venv")) or entry.name == ".gitignore":
                (folder / entry.name).symlink_to(entry)

    def tests(self, paths: Sequence[str], timeout_s: float | None) -> tuple[str, float]:
        """Runs tests up to the first failure. Returns the name of the test that failed, or "", and the seconds."""
        began_s = time.monotonic()
        command = [
            *(sys.executable, "-m", "pytest", "-x", "-q", "--no-header", "--tb=no", "-p", "no:cacheprovider"),
            *("-m", "not root and not long and not sandbox and not flight and not system", *paths),
        ]
        environment = os.environ | {"PYTHONPATH": str(self._folder / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
        with subprocess.Popen(
            command,
            cwd=self._folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        ) as running:
            try:
                printed, _ = running.communicate(timeout=timeout_s)
            except subprocess.TimeoutExpired:
                os.killpg(running.pid, 9)
                return "a hang", time.monotonic() - began_s
        failed = [line for line in printed.splitlines() if line.startswith(("FAILED", "ERROR"))]
        name = failed[0] if failed else "" if running.returncode == 0 else printed[-300:]
        return name, time.monotonic() - began_s

    def judge(self, mutant: Mutant, paths: Sequence[str], timeout_s: float) -> Verdict:
        """Plants the defect, runs the tests, and removes the defect."""
        file = self._folder / mutant.file.relative_to(ROOT)
        sound = file.read_bytes()
        file.write_bytes(mutant.applied())
        try:
            took_s = 0.0
            for path in paths:
                failed, more_s = self.tests([path], timeout_s)
                took_s += more_s
                if failed:
                    return Verdict(mutant, failed, took_s)
            return Verdict(mutant, "", took_s)
        finally:
            file.write_bytes(sound)


def drawn(package: str, count: int, seed: int) -> list[Mutant]:
    """As many mutants of the package, drawn by the seed; those of `argued.txt` are left out."""
    argued = {line.partition("#")[0].strip() for line in ARGUED.read_text().splitlines()}
    files = sorted((ROOT / "src/upwash" / package).rglob("*.py"))
    every = [mutant for file in files for mutant in mutants_of(file)]
    sample = random.Random(seed).sample(every, min(count, len(every)))
    return [mutant for mutant in sample if _key(mutant) not in argued]


def _key(mutant: Mutant) -> str:
    """The name of a mutant, which stays the same when lines move."""
    return f"{mutant.file.relative_to(ROOT)}: {mutant.was} -> {mutant.text}"


def main() -> None:
    """Judges the mutants and prints each survivor, then the score of each package."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("package", nargs="*", help="default: all of " + ", ".join(PACKAGES))
    parser.add_argument("--count", type=int, default=40, help="defects in each package")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(wanted.workers) as pool:
        trees: SimpleQueue[Tree] = SimpleQueue()
        for number in range(wanted.workers):
            place = Path(folder) / str(number)
            place.mkdir()
            trees.put(Tree(place))
        for package in wanted.package or PACKAGES:
            paths = PACKAGES[package]
            tree = trees.get()
            sound = [tree.tests([path], None) for path in paths]
            trees.put(tree)
            if failed := "".join(name for name, _ in sound):
                sys.exit(f"without a defect the tests of {package} fail: {failed}")
            timeout_s = _ROUNDS_S + _TIMES_AS_LONG * wanted.workers * max(took_s for _, took_s in sound)

            def judged(mutant: Mutant, paths: Sequence[str] = paths, timeout_s: float = timeout_s) -> Verdict:
                tree = trees.get()
                try:
                    return tree.judge(mutant, paths, timeout_s)
                finally:
                    trees.put(tree)

            mutants, found = drawn(package, wanted.count, wanted.seed), 0
            for verdict in pool.map(judged, mutants):
                found += bool(verdict.found_by)
                by = verdict.found_by or "SURVIVED"
                mutant = str(verdict.mutant).removeprefix(f"{ROOT}/")
                print(f"{verdict.took_s:5.0f} s  {mutant}  {by}", flush=True)
            print(f"{package}: {found} of {len(mutants)} found, seed {wanted.seed}", flush=True)


if __name__ == "__main__":
    main()
