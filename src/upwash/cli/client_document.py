"""The options of the client's document, which `upwash report` makes."""

from __future__ import annotations

import argparse
import functools
import sys
from collections.abc import Callable, Sequence

from upwash.cli.arguments import reads
from upwash.errors import UsageError
from upwash.report.client.album import MOST_BYTES
from upwash.report.client.document import Wording, client_document
from upwash.report.client.words import NO_WORDS, read_words
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record
from upwash.support.text import counted, printable

CLIENT = {
    "--client": "with -o: the document for the client, of objects, places and pictures, in place of the page",
    "--title TEXT": "with --client: its title (default: Inspection, and the date)",
    "--note TEXT": "with --client: a note under the title; each line is a paragraph",
    "--labels FILE": reads(
        "with --client: a CSV file with the client's words: label, name, severity, colour"
    ),
}
_LONGEST_TITLE, _LONGEST_NOTE = 200, 5000  # characters


def client_document_of(options: argparse.Namespace) -> Callable[[Sequence[Record]], bytes] | None:
    """What makes the document, None without --client; raises UsageError for options that cannot work."""
    if not options.client:
        if options.title or options.note or options.labels:
            raise UsageError("--title, --note and --labels go with --client: nothing else has them")
        return None
    if not options.out:
        raise UsageError("--client goes with -o: name the file of the document")
    if len(options.photos) > 1 and len(options.photos) != len(options.logs):
        raise UsageError(
            f"{len(options.photos)} --photos for {counted(len(options.logs), 'log')}: name one folder for all, or "
            "one for each log"
        )
    for name, text, most in (("title", options.title, _LONGEST_TITLE), ("note", options.note, _LONGEST_NOTE)):
        if text and len(text) > most:
            raise UsageError(f"--{name} has {len(text)} characters: shorten it to {most}")
    wording = Wording(
        title=printable((options.title or "").strip()),
        note=options.note or "",
        words=read_words(options.labels) if options.labels else NO_WORDS,
    )
    shelves = [PhotoShelf(folder) for folder in options.photos or [None]]
    return functools.partial(_document, shelves=shelves, wording=wording)


def _document(records: Sequence[Record], *, shelves: Sequence[PhotoShelf], wording: Wording) -> bytes:
    own = shelves if len(shelves) > 1 else [shelves[0]] * len(records)
    document = client_document(records, own, wording)
    shown = f"{document.shown} of {counted(document.photos, 'photo')}"
    said = f"{len(document.html) / 1e6:.1f} MB, with pictures of {shown}"
    if document.is_full:
        said += f"; further pictures are left out beyond {MOST_BYTES / 1e6:.0f} MB"
    elif document.photos and not document.shown:
        said += ": pictures need OpenCV (upwash[detector]), and those of a folder need --photos DIR"
    print(f"the client's document: {said}", file=sys.stderr)
    return document.html
