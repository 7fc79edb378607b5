"""upwash report: makes a page, and files for other tools, from event logs."""

from __future__ import annotations

import argparse
import functools
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from upwash.cli.arguments import MAP, PRINTED, reads, writes
from upwash.cli.client_document import CLIENT, client_document_of
from upwash.cli.other_policies import OTHERS_FLY, others_flown
from upwash.errors import UsageError
from upwash.report.dataset import require_new, write_dataset
from upwash.report.exports import export_of, write_csv, write_geojson, write_json
from upwash.report.finding_files import FORMATS, findings_file
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record, read_records, reviewed_of
from upwash.report.reviews import NO_REVIEWS, logs_among, review_file
from upwash.support.loading import extra
from upwash.support.output_files import write_file
from upwash.support.progress import work
from upwash.support.spared import require_unwritten
from upwash.support.standard_streams import print_bytes
from upwash.view.file import write_page
from upwash.view.tiles import base_map

Writer = Callable[[Sequence[Record]], bytes | Iterable[bytes]]

ARGUMENTS = {
    "logs LOG": reads("an event log, flown or simulated", nargs="+"),
    "-o --out FILE": writes("an HTML page about all of them, on one map"),
    "--csv FILE": writes("a row for each call; - prints it"),
    "--geojson FILE": writes("tracks, waypoints, ranges, calls and photos"),
    "--findings FILE": writes(
        "each thing that was found, as .csv, .geojson or .kml; as .zip all three, with pictures"
    ),
    "--mcap FILE": writes("a recording that Foxglove opens"),
    "--bag DIR": writes("a ROS 2 bag, a new folder"),
    "--dataset DIR": writes("the photos with accepted boxes, as YOLO's tools train with them, a new folder"),
    "--export": writes(
        "a file of a kind that a plug-in brings; may be given several times",
        nargs=2,
        metavar=("KIND", "FILE"),
        action="append",
        default=[],
    ),
    "--scenario FILE": reads(OTHERS_FLY),
    "--photos DIR": reads(
        "with -o, --mcap, --bag, --findings, --export or --dataset: the folder of the photos that the logs name; "
        "with --client one for all logs, or one for each, in their order",
        action="append",
        default=[],
    ),
    **MAP,
    **CLIENT,
    "--unreviewed": "the findings as the flight told them, without the reviews beside the logs",
    "--json": "print the results as one JSON array",
}


def run(options: argparse.Namespace) -> None:
    """Make the wanted files."""
    options.logs = logs_among(options.logs)
    for log in options.logs:
        require_unwritten(review_file(log))
    for_client = client_document_of(options)
    folder = options.photos[0] if options.photos else None
    files: list[tuple[Path | None, Writer]] = [
        (options.out, for_client or functools.partial(_page, options=options)),
        (options.csv, _in_utf8(write_csv)),
        (options.geojson, _in_utf8(write_geojson)),
        (options.findings, functools.partial(_findings, file=options.findings, photos=folder)),
        (options.mcap, functools.partial(_recording, photos=folder)),
        *((file, export_of(kind.name, folder)) for kind, file in options.export),
        (PRINTED if options.json else None, _in_utf8(lambda records: write_json(records) + "\n")),
    ]
    _require_sense(options)
    wanted = [(file, write) for file, write in files if file is not None]
    if not wanted and not options.bag and not options.dataset:
        raise UsageError(
            "nothing to make: ask for -o FILE, --csv FILE, --geojson FILE, --findings FILE, --mcap FILE, --bag DIR, "
            "--dataset DIR, --export KIND FILE or --json"
        )
    if [file for file, _ in wanted].count(PRINTED) > 1:
        raise UsageError("two outputs would be printed as one: name a file for all but one of them")
    if options.bag:
        with extra("bag"):
            from upwash.report.bag import write_bag
    records = read_records(options.logs, unreviewed=options.unreviewed)
    _tell_reviews(records)
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
            write_bag(records, options.bag, photos=folder)
        print(f"written: {options.bag}", file=sys.stderr)
    if options.dataset:
        with work("writing the data set"):
            told = write_dataset(records, options.dataset, photos=folder)
        print(f"written: {options.dataset} ({told})", file=sys.stderr)


def _require_sense(options: argparse.Namespace) -> None:
    """Raises UsageError for options that do not go together."""
    others = options.mcap or options.findings or options.bag or options.dataset or options.export
    if options.photos and not (options.out or others):
        raise UsageError(
            "--photos goes with -o, --mcap, --bag, --findings, --export or --dataset: nothing else has photos in it"
        )
    if len(options.photos) > 1 and (not options.client or others):
        raise UsageError(
            "several --photos go with --client alone: name one folder, or make the other files by themselves"
        )
    if options.findings and _suffix(options.findings) not in FORMATS:
        endings = ", ".join(f".{name}" for name in FORMATS)
        raise UsageError(
            f"{options.findings} does not say which format the findings must have: end it in one of {endings}"
        )
    if options.scenario and (not options.out or options.client):
        raise UsageError(
            "--scenario goes with -o, without --client: only the flight page says what other policies would have done"
        )
    if options.tiles and (not options.out or options.client):
        raise UsageError("--tiles goes with -o, without --client: only the flight page has a map of tiles")
    if options.dataset:
        if options.unreviewed:
            raise UsageError("--dataset has what was accepted, so it does not go with --unreviewed")
        require_new(options.dataset)


def _tell_reviews(records: Sequence[Record]) -> None:
    """Says how many findings are reviewed, as not every format has room for it."""
    if all(record.reviews is NO_REVIEWS for record in records):
        return
    tally = reviewed_of(records).tally
    for sentence in ([tally.words] if tally.words else []) + list(tally.remarks):
        print(f"findings: {sentence}", file=sys.stderr)


def _page(records: Sequence[Record], *, options: argparse.Namespace) -> Iterable[bytes]:
    flown = others_flown(options.logs, options.scenario)
    photos = options.photos[0] if options.photos else None
    beneath = base_map(options.tiles, options.credit) if options.tiles else None
    return write_page(
        options.logs, records, photos=photos, flown=flown, unreviewed=options.unreviewed, beneath=beneath
    )


def _in_utf8(write: Callable[[Sequence[Record]], str]) -> Writer:
    return lambda records: write(records).encode()


def _findings(records: Sequence[Record], *, file: Path, photos: Path | None) -> bytes:
    return findings_file(_suffix(file), [record.flight for record in records], PhotoShelf(photos))


def _suffix(file: Path) -> str:
    return file.suffix.lower().removeprefix(".")


def _recording(records: Sequence[Record], *, photos: Path | None) -> bytes:
    with extra("mcap"):
        from upwash.report.recording import write_mcap
    return write_mcap(records, folder=photos)
