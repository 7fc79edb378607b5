"""The report: one HTML file that refers to nothing outside it."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from upwash.eventlog.narration import counted
from upwash.report.endings import draw_urgent
from upwash.report.markup import Markup, element
from upwash.report.palette import stylesheet
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record
from upwash.report.scales import Scales
from upwash.report.sections import draw_sections
from upwash.report.summary import draw_summary

_POLICY = (  # should a browser ever find a reference, it follows none
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
)
_SIDE_BY_SIDE = 3  # flights; more are summed up first, and folded each
_PICTURES = 60


def write_page(records: Sequence[Record], *, photos: Path | None = None) -> str:
    """The page about these runs, side by side or, where there are many, one below the other after a summary.

    What was found is shown on the photos of that folder that the logs name, and on rendered ones.
    """
    names = ", ".join(record.name for record in records)
    title = f"Flight report: {names if len(records) <= _SIDE_BY_SIDE else counted(len(records), 'flight')}"
    rules = (files("upwash.report") / "style" / "page.css").read_text(encoding="utf-8")
    style = Markup(stylesheet() + rules)
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", title),
        element("style", style),
    )
    draw = _few if len(records) <= _SIDE_BY_SIDE else _many
    body = element("body", element("main", element("h1", title), *draw(records, PhotoShelf(photos))))
    page = element("html", head, body, lang="en", xmlns="http://www.w3.org/1999/xhtml")
    return f"<!DOCTYPE html>\n{page}\n"


def _few(records: Sequence[Record], shelf: PhotoShelf) -> list[Markup]:
    return draw_sections(records, records, Scales.of(records), shelf, pictures=_PICTURES // len(records))


def _many(records: Sequence[Record], shelf: PhotoShelf) -> list[Markup]:
    scales = Scales.of(records)
    pictures = max(1, _PICTURES // max(1, sum(bool(record.findings) for record in records)))
    flights = [
        element(
            "details",
            element("summary", element("strong", record.name), f": {record.result.mission_time_s:.1f} s"),
            *draw_sections([record], records, scales, shelf, pictures=pictures),
            class_="flight-details",
        )
        for record in records
    ]
    return [
        *draw_urgent(records),
        *draw_summary(records),
        element("section", element("h2", "Each flight"), *flights, class_="folded"),
    ]
