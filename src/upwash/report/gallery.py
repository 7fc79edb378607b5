"""What the user was told, in pictures: the part of the photo around each box, and where it was taken."""

from __future__ import annotations

import base64
import importlib.util
from collections.abc import Iterator

from upwash.report import tables
from upwash.report.crops import Crop, crop_around, pixels_of
from upwash.report.findings import Finding, Outline
from upwash.report.markup import Markup, element, joined
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record

_WITHOUT = (
    "Some findings have no picture. Pictures need OpenCV (upwash[detector]); photos of a folder need --photos FOLDER "
    "too, and those of a video device are not kept."
)


def draw_findings(record: Record, shelf: PhotoShelf, most: int) -> Markup:
    """The findings of the run: a picture of each box, up to so many, and all of them as a table."""
    if not record.findings:
        return element("p", "The user was told nothing.")
    pictures: list[Markup] = []
    missing = False
    for number, finding in enumerate(record.findings, start=1):
        if len(pictures) >= most:
            break
        found = list(_pictures(number, finding, record, shelf))
        missing |= len(found) < max(1, len(finding.boxes))
        pictures += found
    pictures = pictures[:most]
    table = tables.findings(record)
    if not pictures:
        return joined(_note(_WITHOUT), table)
    boxes = sum(len(finding.boxes) for finding in record.findings)
    notes = [_note(_WITHOUT)] if missing else []
    if len(pictures) == most < boxes:
        notes.append(_note(f"The first {most} of {boxes} boxes have a picture."))
    gallery = element("ul", *pictures, class_="gallery")
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
        element("strong", f"{number}: {tables.boxed(box)}"),
        element("br"),
        f"{where}at {finding.at_s:.1f} s",
        element("br"),
        tables.coordinates(finding.place, record.plan.home),
    )
    return element("li", element("figure", _outlined(box, crop), caption))


def _outlined(box: Outline, crop: Crop) -> Markup:
    """The crop with the box drawn on it."""
    corner = {"x": box.left_px - crop.left_px, "y": box.top_px - crop.top_px}
    size = {"width": box.width_px, "height": box.height_px}
    return element(
        "svg",
        element("title", f"{tables.boxed(box)}, on the photo"),
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
