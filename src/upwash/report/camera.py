"""The photos of a run as messages of a recording, with boxes around what the user was told of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from foxglove.messages import (
    Color,
    CompressedImage,
    ImageAnnotations,
    Point2,
    PointsAnnotation,
    PointsAnnotationType,
    TextAnnotation,
    Timestamp,
)

from upwash.eventlog.objects import Outline
from upwash.report.numbering import PlacedFinding
from upwash.report.palette import DARK, components
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record

_FRAME = "camera"
_FONT_PX, _LINE_PX = 16.0, 3.0


def photos(
    record: Record, objects: Sequence[PlacedFinding], time_of: Callable[[float], Timestamp], shelf: PhotoShelf
) -> Iterator[tuple[float, CompressedImage, ImageAnnotations]]:
    """Each available photo, and its boxes with the numbers of the findings, with the second of the shutter.

    `objects` has the object of each of the record's findings. A photo without findings has an empty list of boxes,
    which replaces the boxes of the photo before.
    """
    boxes = _boxes_by_photo(record, objects)
    for photo, event in record.photos:
        taken_s = event.t - event.age_s - record.began_s
        if (jpeg := shelf.find(photo.shot)) is not None:
            time, own = time_of(taken_s), boxes.get(photo.number, [])
            image = CompressedImage(timestamp=time, frame_id=_FRAME, data=jpeg, format="jpeg")
            outlines, labels = [_outline(box, time) for _, box in own], [_label(*each, time) for each in own]
            yield taken_s, image, ImageAnnotations(timestamp=time, points=outlines, texts=labels)


def _boxes_by_photo(record: Record, objects: Sequence[PlacedFinding]) -> dict[int, list[tuple[int, Outline]]]:
    """The boxes on each photo by its number, with the numbers of their findings, without rejected ones."""
    found: dict[int, list[tuple[int, Outline]]] = {}
    for finding, each in zip(record.findings, objects, strict=True):
        shown = each.sighting(finding)
        if shown.photo is not None and shown.box is not None and not each.is_rejected:
            found.setdefault(shown.photo.number, []).append((each.number, shown.box))
    return found


def _outline(found: Outline, time: Timestamp) -> PointsAnnotation:
    left, top = found.left_px, found.top_px
    right, bottom = left + found.width_px, top + found.height_px
    corners = ((left, top), (right, top), (right, bottom), (left, bottom))
    return PointsAnnotation(
        timestamp=time,
        type=PointsAnnotationType.LineLoop,
        points=[Point2(x=x, y=y) for x, y in corners],
        outline_color=_colour(DARK.alarm),
        thickness=_LINE_PX,
    )


def _label(number: int, found: Outline, time: Timestamp) -> TextAnnotation:
    return TextAnnotation(
        timestamp=time,
        position=Point2(x=found.left_px, y=found.top_px),
        text=f"{number} {found.words}",
        font_size=_FONT_PX,
        text_color=_colour(DARK.on_alarm),
        background_color=_colour(DARK.alarm),
    )


def _colour(colour: str) -> Color:
    red, green, blue = components(colour)
    return Color(r=red, g=green, b=blue, a=1.0)
