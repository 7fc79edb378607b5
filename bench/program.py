"""What the programs here share: a command line, with `--quick` for a run of seconds, and the machine's state."""

from __future__ import annotations

import argparse
import os


def command_line(name: str, about: str | None) -> argparse.ArgumentParser:
    """A parser that knows `--quick`; `about` is the program's docstring."""
    parser = argparse.ArgumentParser(prog=f"python -m bench.{name}", description=about)
    parser.add_argument(
        "--quick", action="store_true", help="as little as shows that it runs: its figures mean nothing"
    )
    return parser


def machine() -> str:
    """The number of cores and the load over 1, 5 and 15 minutes, which belong beside every figure."""
    return f"{os.cpu_count()} cores, load {', '.join(f'{load:.2f}' for load in os.getloadavg())}"
