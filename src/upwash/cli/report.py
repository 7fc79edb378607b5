"""upwash report: makes a page, and files for other tools, from event logs."""

from __future__ import annotations

import argparse
import functools
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from upwash.cli.arguments import PRINTED, reads, writes
from upwash.cli.other_policies import OTHERS_FLY, others_flown
from upwash.errors import UsageError
from upwash.report.exports import write_csv, write_geojson, write_json
from upwash.report.finding_files import FORMATS, findings_file
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record, read_records
from upwash.support.loading import extra
from upwash.support.output_files import write_file
from upwash.support.progress import work
from upwash.support.standard_streams import print_bytes
from upwash.view.file import write_page

Writer = Callable[[Sequence[Record]], bytes | Iterable[bytes]]

ARGUMENTS = {
    "logs LOG": reads("an event log, flown or simulated", nargs="+"),
    "-o --out FILE": writes("an HTML page about all of them, side by side"),
    "--csv FILE": writes("a row for each call; - prints it"),
    "--geojson FILE": writes("tracks, waypoints, ranges, calls and photos"),
    "--findings FILE": writes(
        "each thing that was found, as .csv, .geojson or .kml; as .zip all three, with pictures"
    ),
    "--mcap FILE": writes("a recording that Foxglove opens"),
    "--bag DIR": writes("a ROS 2 bag, a new folder"),
    "--scenario FILE": reads(OTHERS_FLY),
    "--photos DIR": reads(
        "with -o, --mcap, --bag or --findings: the folder of the photos that the logs name"
    ),
    "--json": "print the results as one JSON array",
}


def run(options: argparse.Namespace) -> None:
    """Make the wanted files."""
    files: list[tuple[Path | None, Writer]] = [
        (options.out, functools.partial(_page, options=options)),
        (options.csv, _in_utf8(write_csv)),
        (options.geojson, _in_utf8(write_geojson)),
        (options.findings, functools.partial(_findings, file=options.findings, photos=options.photos)),
        (options.mcap, functools.partial(_recording, photos=options.photos)),
        (PRINTED if options.json else None, _in_utf8(lambda records: write_json(records) + "\n")),
    ]
    if options.photos and not (options.mcap or options.out or options.findings or options.bag):
        raise UsageError("--photos goes with -o, --mcap, --bag or --findings: nothing else has photos in it")
    if options.findings and _suffix(options.findings) not in FORMATS:
        endings = ", ".join(f".{name}" for name in FORMATS)
        raise UsageError(
            f"{options.findings} does not say which format the findings must have: end it in one of {endings}"
        )
    if options.scenario and not options.out:
        raise UsageError("--scenario goes with -o: only the page says what other policies would have done")
    wanted = [(file, write) for file, write in files if file is not None]
    if not wanted and not options.bag:
        raise UsageError(
            "nothing to make: ask for -o FILE, --csv FILE, --geojson FILE, --findings FILE, --mcap FILE, --bag DIR "
            "or --json"
        )
    if [file for file, _ in wanted].count(PRINTED) > 1:
        raise UsageError("two outputs would be printed as one: name a file for all but one of them")
    if options.bag:
        with extra("bag"):
            from upwash.report.bag import write_bag
    records = read_records(options.logs)
    written = []
    with work("files made", len(wanted)) as done:
        for file, write in wanted:
            written.append((file, write(records)))
            done()
    for file, content in written:
        if file == PRINTED:
            print_bytes(content)
        else:
            write_file(file, content)
            print(f"written: {file}", file=sys.stderr)
    if options.bag:
        with work("writing the bag"):
            write_bag(records, options.bag, photos=options.photos)
        print(f"written: {options.bag}", file=sys.stderr)


def _page(records: Sequence[Record], *, options: argparse.Namespace) -> Iterable[bytes]:
    flown = others_flown(options.logs, options.scenario)
    return write_page(options.logs, records, photos=options.photos, flown=flown)


def _in_utf8(write: Callable[[Sequence[Record]], str]) -> Writer:
    return lambda records: write(records).encode()


def _findings(records: Sequence[Record], *, file: Path, photos: Path | None) -> bytes:
    return findings_file(_suffix(file), [record.found for record in records], PhotoShelf(photos))


def _suffix(file: Path) -> str:
    return file.suffix.lower().removeprefix(".")


def _recording(records: Sequence[Record], *, photos: Path | None) -> bytes:
    with extra("mcap"):
        from upwash.report.recording import write_mcap
    return write_mcap(records, folder=photos)
