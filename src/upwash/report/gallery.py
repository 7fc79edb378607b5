"""What the user was told, in pictures: the part of the photo around each box, and where it was taken."""

from __future__ import annotations

import base64

from upwash.eventlog.objects import Outline
from upwash.eventlog.progress import clock
from upwash.report import tables
from upwash.report.crops import Crop, cut_out
from upwash.report.findings import MOST_PICTURED
from upwash.report.markup import Markup, element, joined
from upwash.report.numbering import PlacedFinding
from upwash.report.photos import PhotoShelf
from upwash.report.reviewed import ReviewedFindings
from upwash.support.text import printable

_WITHOUT = (
    "Some findings have no picture. Pictures need OpenCV (upwash[detector]); photos of a folder need --photos FOLDER "
    "too, and those of a video device are not kept."
)
_LONGEST_LABEL = 60  # characters


def in_document(jpeg: bytes) -> str:
    """The address of a picture that is in the document itself."""
    return f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"


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
    table = tables.findings(found, whose=whose)
    if not pictures:
        return joined(*notes, table)
    gallery = element("ul", *pictures[:most], class_="gallery")
    return joined(gallery, *notes, tables.folded("The findings as a table", table))


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
        tables.coordinates(found),
        *((element("br"), element("bdi", found.note)) if found.note else ()),
    )
    return element("li", element("figure", drawn, caption))


def outlined(box: Outline, crop: Crop, name: str, *, again: bool = False) -> Markup:
    """The crop with the box drawn on it; `name` is the picture's in the document, which has it already if `again`."""
    corner = {"x": box.left_px - crop.left_px, "y": box.top_px - crop.top_px}
    size = {"width": box.width_px, "height": box.height_px}
    return element(
        "svg",
        element("title", f"{printable(box.words, _LONGEST_LABEL)}, on the photo"),
        element("use", href=f"#{name}") if again else element(
            "image", id=name, href=in_document(crop.jpeg), width=crop.width_px, height=crop.height_px
        ),
        element("rect", **corner, **size, class_="around"),
        element("rect", **corner, **size, class_="box"),
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {crop.width_px} {crop.height_px}",
        role="img",
    )  # fmt: skip
