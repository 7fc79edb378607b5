"""The head of a network that decodes its boxes itself: recognised by what it gives for test pictures, or refused."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from upwash.services.class_names import MOST_LABELS
from upwash.services.darknet.heads import MOST_CANDIDATES, Candidates
from upwash.services.layouts import (
    LAYOUTS,
    Decoder,
    Family,
    Layout,
    are_classes,
    are_mostly_none,
    are_scores,
    are_shares,
    objectness_alone,
    placed,
)
from upwash.support.text import counted

if TYPE_CHECKING:
    from upwash.services.layouts import Floats, Outputs

MOST_VALUES = 50_000_000  # of an output
_FARTHEST_PX = 1e6
_STRIDES = (4, 8, 16, 32, 64, 128)
_MOST_ANCHORS = 9


@dataclass(frozen=True, slots=True)
class BoxHead:
    """The outputs of one network, and how boxes are read from them.

    `shares` is None where the test pictures have no box: then the boxes of each photo say whether they are shares.
    `doubt` is what a person should look at; empty if there is nothing.
    """

    family: Family
    outputs: tuple[str, ...]
    decode: Decoder
    corners: bool
    normalised: bool
    shares: bool | None
    doubt: str

    @property
    def overlaps(self) -> bool:
        """Whether several boxes of one object are left."""
        return self.family in ("YOLOv5", "YOLOv8")

    def read(self, outputs: Sequence[Floats], *, size_px: tuple[int, int], confidence: float) -> Candidates:
        """The boxes that score above `confidence`, at most MOST_CANDIDATES, each of its best class.

        `size_px` are the picture's height and width. Boxes that are no numbers are left out.
        """
        import numpy as np

        with np.errstate(all="ignore"):  # outputs may be infinite
            rows = self.decode([_wide(output) for output in outputs], confidence)
            scores, classes = rows.scores.max(axis=1), rows.scores.argmax(axis=1)
            if rows.classes is not None:
                known = (rows.classes >= 0) & (rows.classes < MOST_LABELS)
                classes = np.where(known, rows.classes, -1).astype(np.intp)
            kept = (scores > confidence) & np.isfinite(rows.boxes).all(axis=1) & (classes >= 0)
            best = np.flatnonzero(kept)[np.argsort(-scores[kept], kind="stable")[:MOST_CANDIDATES]]
            boxes = rows.boxes[best]
            shares = are_shares(boxes) if self.shares is None else self.shares
            height_px, width_px = size_px if shares else (1, 1)
            scale = np.array([width_px, height_px] * 2, np.float32)
            boxes = np.clip(boxes * scale, -_FARTHEST_PX, _FARTHEST_PX)
        if not self.corners:
            centres, halves = boxes[:, :2], boxes[:, 2:] / 2
            boxes = np.hstack([centres - halves, centres + halves])
        return Candidates(boxes, np.minimum(scores[best], 1), classes[best])


def recognise(seen: Sequence[Outputs], *, size_px: tuple[int, int], names: int) -> BoxHead:
    """The head of a network from its outputs for test pictures of that height and width.

    Raises ValueError for a network that gives no boxes, or other boxes, and for a wrong number of names.
    """
    # Old exports of YOLOv5 give its cells a second time, before decoding, with five dimensions.
    given = [
        {name: output for name, output in outputs.items() if output.ndim != 5 and output.size <= MOST_VALUES}
        for outputs in seen
    ]
    _refuse_other_kinds(given)
    for layout in LAYOUTS:
        if not names and any("C" in wanted for wanted in layout.outputs):
            continue
        if outputs := placed(layout, given[0], names):
            values = _joined(layout, outputs, given, names)
            if layout.holds(values, names):
                return _checked(layout, outputs, values, size_px=size_px, pictures=len(seen), names=names)
    raise ValueError(_why_not(given[0], names) or _not_known(seen[0]))


def _joined(layout: Layout, names: Sequence[str], seen: Sequence[Outputs], classes: int) -> list[Floats]:
    """The values of each output for all pictures, one picture behind another; raises ValueError."""
    import numpy as np

    if any(placed(layout, outputs, classes) != tuple(names) for outputs in seen):
        shapes = " and ".join(_shapes(outputs) for outputs in seen)
        raise ValueError(
            f"its outputs for a grey picture, noise and a photo differ ({shapes}): {_OWN_SERVICE}"
        )
    if not all(np.isfinite(outputs[name]).all() for outputs in seen for name in names):
        raise ValueError(
            "some numbers of its outputs are infinite or none (NaN) for a grey picture, noise or a photo: export it "
            "with 32-bit floats"
        )
    axes = [wanted.split()[1:].index("n") if "n" in wanted.split() else 0 for wanted in layout.outputs]
    return [
        _wide(np.concatenate([outputs[name] for outputs in seen], axis))
        for name, axis in zip(names, axes, strict=True)
    ]


def _wide(output: Floats) -> Floats:
    import numpy as np

    return output.astype(np.float32, copy=False) if output.dtype.kind == "f" else output


def _checked(
    layout: Layout,
    outputs: tuple[str, ...],
    values: Sequence[Floats],
    *,
    size_px: tuple[int, int],
    pictures: int,
    names: int,
) -> BoxHead:
    """The head, if what it gave for the test pictures fits its family; raises ValueError."""
    rows, decode = layout.decode(values, -math.inf), layout.decode
    scores, count = rows.scores, len(rows.boxes) // pictures
    if rows.classes is not None and (highest := int(rows.classes.max(initial=0))) >= names:
        raise ValueError(_wrong_names(f"output {outputs[-1]} has class {highest}", names))
    # YOLOv6 has one box a cell too, and an objectness of 1.
    if layout.family == "YOLOv5" and (values[0][0, :, 4] < 1).any():
        if count == sum(_cells(size_px)[1:4]):
            raise ValueError(
                f"its output has {count} cells of one box and an objectness, as of YOLOX, whose pictures and boxes "
                f"are others: {_OWN_SERVICE}"
            )
        if names == 1:  # whose class training of YOLOv5 and v7 leaves out: its values say nothing
            decode = objectness_alone
    if scores.size and not are_scores(scores):
        raise ValueError(
            f"its outputs are like those of {layout.family} networks, but scores are from {scores.min():.3g} to "
            f"{scores.max():.3g}, not from 0 to 1: export it with decoded boxes, or {_OWN_SERVICE}"
        )
    shares = None if layout.corners and not rows.boxes.any() else are_shares(rows.boxes)
    head = BoxHead(layout.family, outputs, decode, layout.corners, layout.normalised, shares, "")
    if head.overlaps and not _fills_cells(count, size_px):
        return replace(
            head, doubt=f"its {count} boxes are not those of the cells of {by(size_px)} pixels: {COMPARE}"
        )
    return head


def _cells(size_px: tuple[int, int]) -> list[int]:
    return [(size_px[0] // stride) * (size_px[1] // stride) for stride in _STRIDES]


def _fills_cells(count: int, size_px: tuple[int, int]) -> bool:
    """Whether that many boxes are the same number for each cell of one layer or of several in order."""
    cells = _cells(size_px)
    layers = {sum(cells[first:last]) for last in range(1, len(cells) + 1) for first in range(last)} - {0}
    return any(count % layer == 0 and count // layer <= _MOST_ANCHORS for layer in layers)


# --- refusals -----------------------------------------------------------------------------------------------------

_OWN_SERVICE = "run it in a service of your own (docs/detector.md shows one of 20 lines)"
_DETECTS = f"export a network of the task detect, or {_OWN_SERVICE}"
COMPARE = "compare the boxes of some photos with those of the tool that exported it"
IN_FLOATS = (
    "leave its last layers, which make boxes and scores, in floats when it is quantised to 8 bits, or export it with "
    "16-bit floats"
)


def _refuse_other_kinds(seen: Sequence[Outputs]) -> None:
    """Raises ValueError for outputs that no number of names makes scored boxes."""
    import numpy as np

    first = seen[0]
    shapes = {name: output.shape for name, output in first.items() if output.dtype.kind == "f"}
    if {3, 4} <= {len(shape) for shape in shapes.values()}:
        raise ValueError(f"it gives masks beside boxes ({_shapes(first)}): {_DETECTS}")
    if {"dets", "labels"} <= set(first):
        raise ValueError(
            f"its outputs are those of RF-DETR ({_shapes(first)}), whose pictures are others: {_OWN_SERVICE}"
        )
    if len(first) != 1 or len(shapes) != 1:
        return
    ((name, shape),) = shapes.items()
    if len(shape) == 2 and shape[0] == 1 and shape[1] != 7:
        raise ValueError(f"it says what a picture shows, and not where ({_shapes(first)}): {_DETECTS}")
    if len(shape) == 2 and shape[1] == 7:
        given = [outputs[name][np.newaxis, :, 1:] for outputs in seen]  # behind the picture's number
    elif len(shape) == 3 and shape[0] == 1 and all(outputs[name].shape == shape for outputs in seen):
        is_turned = shape[1] < shape[2] and shape[2] not in (6, 7)
        given = [outputs[name].transpose(0, 2, 1) if is_turned else outputs[name] for outputs in seen]
    else:
        return
    rows = _wide(np.concatenate(given, axis=1))[0]
    places, rest = np.unique(rows[:, :4]), rows[:, 4:]
    step = np.diff(places).min(initial=np.inf)
    if 1 < step < np.inf and not ((rest > 0) & (rest <= 1)).any():
        raise ValueError(
            f"output {name} has boxes and scores together in steps of {step:.3g}, as of 8 bits, so that each score "
            f"is 0: {IN_FLOATS}"
        )
    scores = [are_scores(column) for column in rest.T]
    classes = scores.index(False) if False in scores else len(scores)
    if classes == 1 and len(scores) > 1 and are_classes(rest[:, 1]):
        classes = 2  # a score and a class
    if classes == 1 and shape[-1] == 6:
        raise ValueError(f"the classes in its output {name} are no whole numbers, as of 8 bits: {IN_FLOATS}")
    if 0 < classes < len(scores):
        more = len(scores) - classes
        kind = "an angle (rotated boxes)" if more == 1 else f"{more} numbers (key points or masks)"
        raise ValueError(f"each box has {kind} beside its scores ({_shapes(first)}): {_DETECTS}")


def _why_not(outputs: Outputs, names: int) -> str:
    """What number of names the outputs of a picture would need; empty for outputs that no number explains."""
    shapes = {name: output.shape for name, output in outputs.items() if output.dtype.kind == "f"}
    if len(shapes) != len(outputs) or any(len(shape) != 3 or shape[0] != 1 for shape in shapes.values()):
        return ""
    if len(shapes) == 1:
        ((name, (_, height, width)),) = shapes.items()
        seen = f"output {name} is {by(shapes[name])}, as of"
        if width == 6 and are_classes(classes := outputs[name][0, :, 5]):
            return _wrong_names(f"{seen} an end-to-end head that has class {classes.max(initial=0):g}", names)
        if 5 <= height < width:
            return _wrong_names(f"{seen} YOLOv8 with {_classes(height - 4)}", names)
        if 5 <= width < height:
            ways = f"YOLOv5 with {_classes(width - 5)} or DETR with {_classes(width - 4)}"
            return _wrong_names(f"{seen} {ways}", names)
    boxes = sorted((name for name in shapes if shapes[name][2] == 4), key=lambda name: "box" not in name)[:1]
    rest = [name for name in shapes if name not in boxes]
    if (
        len(boxes) == len(rest) == 1
        and shapes[boxes[0]][1] == shapes[rest[0]][1]
        and are_shares(outputs[boxes[0]])
    ):
        if are_mostly_none(outputs[rest[0]], last=False):
            return f"the first class in its output {rest[0]} is the background, as of SSD: {_OWN_SERVICE}"
        has_none = are_mostly_none(outputs[rest[0]])
        number = _classes(shapes[rest[0]][2] - has_none) + (' and "no object"' if has_none else "")
        return _wrong_names(f"output {rest[0]} is {by(shapes[rest[0]])}, as of DETR with {number}", names)
    return ""


def _not_known(outputs: Outputs) -> str:
    return (
        f"its outputs are not understood ({_shapes(outputs)}): boxes as of YOLOv5, YOLOv8 and later, end-to-end or "
        f"DETR are, and YOLOv3's raw heads if the setting heads describes them; {_OWN_SERVICE}"
    )


def _shapes(outputs: Outputs) -> str:
    return ", ".join(f"{name}: {by(output.shape)} {output.dtype}" for name, output in outputs.items())


def _wrong_names(seen: str, names: int) -> str:
    there = "there is 1 name" if names == 1 else f"there are {names} names"
    there = there if names else "its metadata has no names"
    return f"{seen}, but {there}: give names, a file with a line for each class"


def _classes(number: int) -> str:
    return counted(number, "class") if number == 1 else f"{number} classes"


def by(shape: Iterable[object]) -> str:
    """The shape as people write it."""
    return " x ".join(map(str, shape))
