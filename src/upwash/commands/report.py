"""upwash report: makes a page, and files for other tools, from event logs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from upwash.commands.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    report = commands.add_parser("report", help="make a page, and files for other tools, from event logs")
    report.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="an event log, flown or simulated")
    report.add_argument(
        "-o", "--out", type=Path, metavar="FILE", help="an HTML page about all of them, side by side"
    )
    report.add_argument("--csv", type=Path, metavar="FILE", help="a row for each call")
    report.add_argument("--geojson", type=Path, metavar="FILE", help="tracks, waypoints, ranges and calls")
    report.add_argument("--json", action="store_true", help="print the results as one JSON array")
    report.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Makes what was asked for."""
    from upwash.errors import UsageError
    from upwash.report.exports import write_csv, write_geojson, write_json
    from upwash.report.page import write_page
    from upwash.report.record import read_records

    files = [(options.out, write_page), (options.csv, write_csv), (options.geojson, write_geojson)]
    wanted = [(file, write) for file, write in files if file is not None]
    if not wanted and not options.json:
        raise UsageError("nothing to make: ask for -o FILE, --csv FILE, --geojson FILE or --json")
    records = read_records(options.logs)
    written = [(file, write(records)) for file, write in wanted]
    for file, content in written:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content, encoding="utf-8")
        print(f"written: {file}", file=sys.stderr)
    if options.json:
        print(write_json(records))
    return True
