"""Objects on photos in what a service answers or a mission tells: recognised by the names of their fields.

Every detector has a class of its own for its results. An object is a box or a point with a label. `_px` may follow
the name of a field, and a score is optional.

- box: left, top, width, height; left, top, right, bottom; x1, y1, x2, y2; xmin, ymin, xmax, ymax;
  x, y, width, height from the upper left; or one of these in a field box, bbox or rect
- point: x, y; or these in a field point or centre
- label: label, name, kind, species, class_name, category
- score: score, confidence, probability
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeGuard

import msgspec

from upwash.support.text import counted, printable

_LABELS = ("label", "name", "kind", "species", "class_name", "category")
_SCORES = ("score", "confidence", "probability")
_INSIDE = ("box", "bbox", "rect", "point", "centre", "center")
_SIZES = (("left", "top", "width", "height"), ("x", "y", "width", "height"), ("x", "y", "w", "h"))
_CORNERS = (("left", "top", "right", "bottom"), ("x1", "y1", "x2", "y2"), ("xmin", "ymin", "xmax", "ymax"))
_FARTHEST_PX = 1e6
_LONGEST_NOUN = 40  # characters
FAULTS = {  # labels of the bundled detector, in words
    "hot-spot": "hot-spot",
    "broken-module": "broken module",
}


class Outline(msgspec.Struct, frozen=True, omit_defaults=True, gc=False):
    """A box in a photo, in its pixels; without a score where none is known. A point has no width and height."""

    left_px: float
    top_px: float
    width_px: float
    height_px: float
    label: str
    score: float | None = None

    @property
    def words(self) -> str:
        """What it is around, and how sure that is."""
        return self.label if self.score is None else f"{self.label} {100 * self.score:.0f} %"

    @property
    def middle_and_size(self) -> tuple[float, float, float, float]:
        """The middle, to the right and down, and the size."""
        middle = self.left_px + self.width_px / 2, self.top_px + self.height_px / 2
        return *middle, self.width_px, self.height_px


def noun_of(label: str) -> str:
    """What people call an object of that label."""
    return FAULTS.get(label) or printable(label.replace("_", " "), _LONGEST_NOUN) or "object"


def count_of_kind(label: str, number: int) -> str:
    """The number of objects of that label in words: "2 broken modules"."""
    noun = noun_of(label)
    return counted(number, noun) if noun[-1:].isalpha() else f"{number} x {noun}"


def found_objects(message: object) -> list[Outline] | None:
    """The objects of a message of plain values: of one object, or of a list of nothing else; None for any other."""
    items = message if isinstance(message, list) else [message]
    found = [_object(item) for item in items]
    whole = [item for item in found if item is not None]
    return whole if len(whole) == len(found) else None


def _object(item: object) -> Outline | None:
    if not isinstance(item, Mapping):
        return None
    fields = {str(name).removesuffix("_px"): value for name, value in item.items()}
    label = next((fields[name] for name in _LABELS if isinstance(fields.get(name), str)), None)
    outline = _outline(fields)
    if label is None or outline is None:
        return None
    score = next((fields[name] for name in _SCORES if _is_number(fields.get(name))), None)
    return Outline(*outline, label, None if score is None else float(score))


def _outline(fields: Mapping[str, object]) -> tuple[float, float, float, float] | None:
    """Left, top, width and height."""
    for names in _SIZES:
        if numbers := _numbers(fields, names):
            return numbers if min(numbers[2:]) >= 0 else None
    for names in _CORNERS:
        if numbers := _numbers(fields, names):
            left, top, right, bottom = numbers
            return (left, top, right - left, bottom - top) if right >= left and bottom >= top else None
    for name in _INSIDE:
        inner = fields.get(name)
        if isinstance(inner, Mapping):
            return _outline(
                {str(key).removesuffix("_px"): value for key, value in inner.items() if key not in _INSIDE}
            )
    x, y = fields.get("x"), fields.get("y")
    return (float(x), float(y), 0.0, 0.0) if _is_number(x) and _is_number(y) else None


def _numbers(
    fields: Mapping[str, object], names: tuple[str, ...]
) -> tuple[float, float, float, float] | None:
    found = [float(value) for name in names if _is_number(value := fields.get(name))]
    return (found[0], found[1], found[2], found[3]) if len(found) == len(names) else None


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _FARTHEST_PX
