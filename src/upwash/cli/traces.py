"""upwash traces: makes traces for simulations from an event log."""

from __future__ import annotations

import argparse
from pathlib import Path

from upwash.cli.arguments import fills, reads
from upwash.errors import UsageError
from upwash.report.record import read_records
from upwash.report.traces import settings_of, traces_of
from upwash.support.output_files import write_file
from upwash.support.progress import work

ARGUMENTS = {
    "log LOG": reads("an event log, flown or simulated"),
    "--out DIR": fills("where the files go (default: traces)", default=Path("traces")),
}


def run(options: argparse.Namespace) -> None:
    """Write the files, and print the lines of a scenario that name them."""
    (record,) = read_records([options.log])
    with work("making traces"):
        files = traces_of(record)
    if not files:
        raise UsageError(
            f"{options.log} has no take-off and no call on a server, so that no trace can be made of it"
        )
    for name, text in files.items():
        write_file(options.out / name, text.encode())
    print(f"# written to {options.out}")
    print("\n".join(settings_of(files)))
