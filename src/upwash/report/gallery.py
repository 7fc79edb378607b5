"""What the user was told, in pictures: the part of the photo around each box, and where it was taken."""

from __future__ import annotations

import base64
import importlib.util
from collections.abc import Iterator

from upwash.report import tables
from upwash.report.crops import Crop, crop_around, pixels_of
from upwash.report.findings import MOST_PICTURED, Finding, Outline
from upwash.report.markup import Markup, element, joined
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record
from upwash.support.text import printable

_WITHOUT = (
    "Some findings have no picture. Pictures need OpenCV (upwash[detector]); photos of a folder need --photos FOLDER "
    "too, and those of a video device are not kept."
)
_LONGEST_LABEL = 60  # characters


def draw_findings(record: Record, shelf: PhotoShelf, most: int) -> Markup:
    """The findings of the run: a picture of each box, up to so many, and all of them as a table."""
    pictures: list[Markup] = []
    lacking = False
    for number, finding in enumerate(record.findings[:MOST_PICTURED], start=1):
        found = list(_pictures(number, finding, record, shelf)) if len(pictures) < most else []
        lacking |= len(found) < len(finding.boxes)
        pictures += found
    notes = []
    if len(pictures) >= most:
        notes.append(_note(f"No more than {most} pictures are shown; the table has every finding."))
    elif lacking:
        notes.append(_note(_WITHOUT))
    table = tables.findings(record)
    if not pictures:
        return joined(*notes, table)
    gallery = element("ul", *pictures[:most], class_="gallery")
    return joined(gallery, *notes, tables.folded("The findings as a table", table))


def _note(text: str) -> Markup:
    return element("p", text, class_="note")


def _pictures(number: int, finding: Finding, record: Record, shelf: PhotoShelf) -> Iterator[Markup]:
    if finding.shot is None or not finding.boxes or importlib.util.find_spec("cv2") is None:
        return
    jpeg = shelf.find(finding.shot)
    pixels = None if jpeg is None else pixels_of(jpeg)
    if pixels is None:
        return
    for box in finding.boxes:
        if (crop := crop_around(box, pixels)) is not None:
            yield _picture(number, finding, box, crop, record)


def _picture(number: int, finding: Finding, box: Outline, crop: Crop, record: Record) -> Markup:
    where = "" if finding.waypoint is None else f"waypoint {finding.waypoint}, "
    caption = element(
        "figcaption",
        element("strong", f"{number}: {_words(box)}"),
        element("br"),
        f"{where}at {finding.at_s:.1f} s",
        element("br"),
        tables.coordinates(finding.place, record.plan.home),
    )
    return element("li", element("figure", _outlined(box, crop), caption))


def _words(box: Outline) -> str:
    return printable(box.words, _LONGEST_LABEL)


def _outlined(box: Outline, crop: Crop) -> Markup:
    """The crop with the box drawn on it."""
    corner = {"x": box.left_px - crop.left_px, "y": box.top_px - crop.top_px}
    size = {"width": box.width_px, "height": box.height_px}
    return element(
        "svg",
        element("title", f"{_words(box)}, on the photo"),
        element(
            "image", href=f"data:image/jpeg;base64,{base64.b64encode(crop.jpeg).decode()}",
            width=crop.width_px, height=crop.height_px,
        ),
        element("rect", **corner, **size, class_="around"),
        element("rect", **corner, **size, class_="box"),
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {crop.width_px} {crop.height_px}",
        role="img",
    )  # fmt: skip
