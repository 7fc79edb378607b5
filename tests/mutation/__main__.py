"""Plants defects in packages, one at a time, and counts those that the packages' tests find.

    python -m tests.mutation                    # 40 defects in each package of PACKAGES
    python -m tests.mutation core rpc --count 100 --seed 2 --notes /tmp/notes

First the tests run once, to note which functions each of them enters. Then a defect is judged by the tests that enter
its function, until one fails or the time is over. The defects are drawn by the seed, so
that a score can be compared with an earlier one. A survivor is a defect that none of these tests finds: write the
test, or enter the defect into `argued.txt` with the reason why it does no harm. The scores are in `score.md`.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
from tests.mutation.mutants import Mutant, mutants_of
from tests.mutation.planted import Job, Outcome

ROOT = Path(__file__).parents[2]
ARGUED = Path(__file__).with_name("argued.txt")
PACKAGES = {  # the tests that judge a package
    "core": ("tests/core", "tests/server", "tests/drone"),
    "drone": ("tests/drone", "tests/ports/contracts/test_network.py"),
    "rpc": ("tests/rpc", "tests/server"),
    "server": ("tests/server",),
    "real/mavlink": ("tests/ports",),
    "core/call": ("tests/core/call",),
}
_SMALLEST = 400  # tests that come first, as they enter the fewest functions; then those that enter the most
_PYTEST = (
    sys.executable,
    "-m",
    "pytest",
    "-q",
    "--no-header",
    "--tb=no",
    "-p",
    "no:cacheprovider",
    "--timeout=120",
)
_ORDINARY = "not root and not long and not nightly and not sandbox and not flight and not system"


class Notes(msgspec.Struct):
    """What `entered.py` writes."""

    functions: dict[str, list[str]]

    def tests_of(self, mutant: Mutant) -> list[str]:
        """The tests that enter the defect's function; where it has none, those that enter its file."""
        entry = f"{mutant.file.relative_to(ROOT)}:{mutant.function}"
        chosen = [
            test
            for test, entered in self.functions.items()
            if any(each.startswith(entry) if not mutant.function else each == entry for each in entered)
        ]
        chosen = sorted(chosen or self.functions, key=lambda test: len(self.functions[test]))
        return [*chosen[:_SMALLEST], *reversed(chosen[_SMALLEST:])]


def noted(package: str, folder: Path) -> Notes:
    """Which functions the tests of the package enter; from the folder, if it has the notes already."""
    parts = []
    for path in PACKAGES[package]:
        file = folder / f"{path.replace('/', '-')}.json"
        if not file.exists():
            command = (*_PYTEST, "-p", "tests.mutation.entered", "-m", _ORDINARY, path)
            ran = subprocess.run(
                command,
                cwd=ROOT,
                env=os.environ | {"MUTATION_ENTERED": str(file)},
                capture_output=True,
                text=True,
                check=False,
            )
            if ran.returncode != 0:
                sys.exit(f"without a defect tests fail in {path}: {ran.stdout[-500:]}")
        parts.append(msgspec.json.decode(file.read_bytes(), type=Notes))
    return Notes({test: entered for part in parts for test, entered in part.functions.items()})


def judged(jobs: Sequence[Job], folder: Path, place: Path = ROOT) -> list[Outcome]:
    """What becomes of each defect, by the tests and sources of a place; fewer where tests cannot be collected."""
    if not jobs:
        return []
    file = folder / "jobs"
    outcomes = file.with_suffix(".outcomes")
    outcomes.unlink(missing_ok=True)
    file.write_bytes(b"".join(msgspec.json.encode(job, enc_hook=str) + b"\n" for job in jobs))
    paths = {test.partition("::")[0] for job in jobs for test in job.tests}
    subprocess.run(
        (
            *_PYTEST,
            "-p",
            "tests.mutation.planted",
            "-m",
            _ORDINARY,
            *sorted(path for path in paths if (place / path).exists()),
        ),
        cwd=place,
        env=os.environ
        | {"MUTATION_JOBS": str(file), "PYTHONPATH": str(place / "src"), "PYTHONDONTWRITEBYTECODE": "1"},
        stdout=subprocess.DEVNULL,
        check=False,
    )
    lines = outcomes.read_bytes().splitlines() if outcomes.exists() else []
    return [msgspec.json.decode(line, type=Outcome) for line in lines]


def judged_alone(mutant: Mutant, tests: list[str], folder: Path) -> Outcome:
    """What becomes of a defect that must perhaps be there at the import: planted in a copy of the sources."""
    place = folder / "copy"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    for entry in ROOT.iterdir():
        if entry.name == "src":
            shutil.copytree(entry, place / "src", ignore=shutil.ignore_patterns("__pycache__"))
        elif not entry.name.startswith((".git", ".venv")) or entry.name == ".gitignore":
            (place / entry.name).symlink_to(entry)
    (place / mutant.file.relative_to(ROOT)).write_bytes(mutant.applied())
    outcomes = judged([Job(None, tests)], folder, place)
    return outcomes[0] if outcomes else Outcome("the collection of the tests", 0.0)


def drawn(package: str, count: int, seed: int) -> list[Mutant]:
    """As many mutants of the package, drawn by the seed."""
    files = sorted((ROOT / "src/upwash" / package).rglob("*.py"))
    every = [mutant for file in files for mutant in mutants_of(file)]
    return random.Random(seed).sample(every, min(count, len(every)))


def score(package: str, mutants: Sequence[Mutant], notes: Notes, folder: Path) -> str:
    """Judges the mutants and prints what finds each; the row of the table."""
    harmless = {line.partition("  # ")[0] for line in ARGUED.read_text().splitlines()}
    argued = [mutant for mutant in mutants if _key(mutant) in harmless]
    tests = {mutant: notes.tests_of(mutant) for mutant in mutants if mutant not in argued}
    in_functions = [mutant for mutant in tests if mutant.function]
    outcomes = judged([Job(mutant, tests[mutant]) for mutant in in_functions], folder)
    known = dict(zip(in_functions, outcomes, strict=True))
    found = 0
    for mutant, chosen in tests.items():
        outcome = known.get(mutant)
        if outcome is None or not outcome.found_by:
            outcome = judged_alone(mutant, chosen, folder)
        found += bool(outcome.found_by)
        by = outcome.found_by or f"SURVIVED  {_key(mutant)}"
        print(f"{outcome.took_s:5.0f} s  {str(mutant).removeprefix(f'{ROOT}/')}  {by}", flush=True)
    return f"{len(mutants)} planted, {found} found, {len(argued)} argued"


def _key(mutant: Mutant) -> str:
    """The name of a mutant, which stays the same while its line does."""
    line = mutant.file.read_text().splitlines()[mutant.line - 1].partition("  #")[0].strip()
    return f"{mutant.file.relative_to(ROOT)}: {line}: {mutant.was} -> {mutant.text}"


def main() -> None:
    """Judges mutants of each package, and prints each score."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("package", nargs="*", help="default: all of " + ", ".join(PACKAGES))
    parser.add_argument("--count", type=int, default=40, help="defects in each package")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2, help="packages at a time")
    parser.add_argument("--notes", type=Path, help="a folder that keeps what the tests enter")
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(wanted.workers) as pool:

        def run(package: str) -> str:
            folder = Path(scratch) / package.replace("/", "-")
            folder.mkdir()
            keep = wanted.notes or folder
            keep.mkdir(exist_ok=True)
            mutants = drawn(package, wanted.count, wanted.seed)
            return f"{package}: seed {wanted.seed}: {score(package, mutants, noted(package, keep), folder)}"

        for line in list(pool.map(run, wanted.package or PACKAGES)):
            print(line)


if __name__ == "__main__":
    main()
