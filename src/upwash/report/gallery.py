"""What the user was told, in pictures: the part of the photo around each box, and where it was taken."""

from __future__ import annotations

from collections.abc import Sequence

from upwash.eventlog.objects import Outline
from upwash.report.crops import Crop, cut_out
from upwash.report.findings import MOST_PICTURED
from upwash.report.markup import Markup, element, in_document, joined, svg
from upwash.report.numbering import PlacedFinding
from upwash.report.photos import PhotoShelf
from upwash.report.reviewed import ReviewedFindings
from upwash.report.tables import table
from upwash.support.text import clock, printable

_WITHOUT = (
    "Some findings have no picture. Pictures need OpenCV (upwash[detector]); photos of a folder need --photos FOLDER "
    "too, and those of a video device are not kept."
)
_LONGEST_LABEL = 60  # characters


def draw_findings(reviewed: ReviewedFindings, shelf: PhotoShelf, *, most: int, whose: bool = False) -> Markup:
    """Pictures of at most `most` boxes, and a table of all; `whose` says that each has the name of its flight.

    Rejected findings are left out; a sentence says how many were reviewed.
    """
    found, tally = reviewed.objects, reviewed.tally
    pictures: list[Markup] = []
    lacking = False
    for each in found[:MOST_PICTURED]:
        if each.finding.box is not None and len(pictures) < most:
            crop = cut_out(each.finding, shelf)
            lacking |= crop is None
            if crop is not None:
                drawn = outlined(each.finding.box, crop, f"crop-{each.best[0]}-{each.best[1]}")
                pictures.append(_picture(each, drawn, whose=whose))
    notes = [_note(f"{tally.words}.")] if tally.words else []
    notes += [_note(f"{remark[:1].upper()}{remark[1:]}.") for remark in tally.remarks]
    if len(pictures) >= most:
        notes.append(_note(f"No more than {most} pictures are shown; the table has every finding."))
    elif lacking:
        notes.append(_note(_WITHOUT))
    every = _table(found, whose=whose)
    if not pictures:
        return joined(*notes, every)
    gallery = element("ul", *pictures[:most], class_="gallery")
    folded = element("details", element("summary", "The findings as a table"), every)
    return joined(gallery, *notes, folded)


def _note(text: str) -> Markup:
    return element("p", text, class_="note")


def _picture(found: PlacedFinding, drawn: Markup, *, whose: bool) -> Markup:
    finding = found.finding
    flight = f"{found.flight.log}, " if whose else ""
    where = "" if finding.waypoint is None else f"waypoint {finding.waypoint}, "
    caption = element(
        "figcaption",
        element(
            "strong",
            f"{found.number}: ",
            element("bdi", printable(finding.words, _LONGEST_LABEL).replace(" %", "\N{NO-BREAK SPACE}%")),
        ),
        element("br"),
        f"{flight}{where}at {clock(found.mission_s)}",
        element("br"),
        coordinates(found),
        *((element("br"), element("bdi", found.note)) if found.note else ()),
    )
    return element("li", element("figure", drawn, caption))


def _table(found: Sequence[PlacedFinding], *, whose: bool) -> Markup:
    """A row a finding, with the names of their flights where it matters `whose` each is."""
    are_reviewed = any(each.review for each in found)
    flight, review = ["flight"] if whose else [], ["review"] if are_reviewed else []

    def row(each: PlacedFinding) -> list[str]:
        return [
            str(each.number),
            *([each.flight.log] if whose else []),
            clock(each.mission_s),
            "start" if each.finding.waypoint is None else str(each.finding.waypoint),
            coordinates(each),
            element("bdi", each.finding.words),  # may be written from right to left
            *([_reviewed(each)] if are_reviewed else []),
        ]

    heads = ["finding", *flight, "at", "waypoint", "place", "what the user was told", *review]
    return table("Findings", heads, found, row, rest="--findings FILE writes every finding")


def _reviewed(found: PlacedFinding) -> Markup:
    """The verdict and the note of a finding; empty without them."""
    verdict = found.review.verdict.value if found.review and found.is_reviewed else ""
    return joined(verdict, ": " if verdict and found.note else "", element("bdi", found.note))


def coordinates(found: PlacedFinding, home: str = "home") -> str:
    """The place in degrees where it is known where home is, else in metres from there."""
    if found.earth is not None:
        return "{:.6f}°, {:.6f}°".format(*found.earth)
    return f"{found.finding.place.east_m:.1f} m east, {found.finding.place.north_m:.1f} m north of {home}"


def outlined(box: Outline, crop: Crop, name: str, *, again: bool = False) -> Markup:
    """The crop with the box drawn on it; `name` is the picture's in the document, which has it already if `again`."""
    corner = {"x": box.left_px - crop.left_px, "y": box.top_px - crop.top_px}
    size = {"width": box.width_px, "height": box.height_px}
    whole = {"width": crop.width_px, "height": crop.height_px}
    return svg(
        f"0 0 {crop.width_px} {crop.height_px}",
        element("title", f"{printable(box.words, _LONGEST_LABEL)}, on the photo"),
        element("use", href=f"#{name}")
        if again
        else element("image", id=name, href=in_document(crop.jpeg), **whole),
        element("rect", **corner, **size, class_="around"),
        element("rect", **corner, **size, class_="box"),
    )
