"""How large the house is, in lines of each room, tests and benches. Run `python -m bench.size [--against DIR]`."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SUFFIXES = (".py", ".js", ".css", ".html")


def rooms(checkout: Path) -> Counter[str]:
    """The lines of each room of the source, and of tests and benches."""
    lines = Counter[str]()
    for file in _files(checkout):
        parts = file.relative_to(checkout).parts
        room = (
            parts[2]
            if parts[0] == "src" and len(parts) > 3
            else "upwash"
            if parts[0] == "src"
            else f"({parts[0]})"
        )
        lines[room] += file.read_text().count("\n")
    return lines


def _files(checkout: Path) -> Iterator[Path]:
    for folder in ("src", "tests", "bench"):
        yield from (
            file for file in (checkout / folder).rglob("*") if file.suffix in SUFFIXES and file.is_file()
        )


def main() -> None:
    """Print a row for each room, and the whole of the source."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.size", description=(__doc__ or "").partition(".")[0]
    )
    parser.add_argument("--against", type=Path, metavar="DIR", help="the lines of this checkout, too")
    options = parser.parse_args()
    now = rooms(ROOT)
    before = rooms(options.against.resolve()) if options.against else now
    for counts in (before, now):
        counts["source"] = sum(count for room, count in counts.items() if not room.startswith("("))
    for room in sorted(now.keys() | before.keys()):
        change = f" {now[room] - before[room]:+8,}" if options.against else ""
        print(f"{room:12} {now[room]:8,}{change}")


if __name__ == "__main__":
    main()
