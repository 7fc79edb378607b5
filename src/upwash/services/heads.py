"""Boxes that a network decodes itself: the family of its outputs, and the boxes in them.

- YOLOv5, also v6 and v7: 1 x cells x (5 + classes): centre and size of a box, objectness, classes
- YOLOv8, also v9, v11 and later: 1 x (4 + classes) x cells: centre and size, classes
- end-to-end, as YOLOv10, YOLO26 and exports that suppress: 1 x boxes x 6: corners, score, class;
  YOLOv7's have boxes x 7: picture, corners, class, score
- DETR: 1 x boxes x (4 + classes), or two outputs for these: centre and size as shares of the picture, classes;
  or three outputs for boxes by their corners, scores and labels

YOLOv3's raw heads, which need anchors, are those of `darknet/heads.py`.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Literal

from upwash.services.darknet.heads import MOST_CANDIDATES, Candidates, sigmoid
from upwash.support.text import counted

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

Family = Literal["YOLOv5", "YOLOv8", "end-to-end", "DETR"]

MOST_VALUES = 50_000_000  # of an output
MOST_LABELS = 100_000
_MOST_NAMES_LETTERS = 2_000_000
_FARTHEST_PX = 1e6
_LARGEST_SHARE = 2.0  # of the picture: a larger number is one of pixels
_STRIDES = (8, 16, 32)
_NAME = re.compile(r"""\s*(?:["']?(\d{1,6})["']?\s*:\s*)?('(?:[^'\\\n]|\\.)*'|"(?:[^"\\\n]|\\.)*")\s*(,|$)""")


@dataclass(frozen=True, slots=True)
class BoxHead:
    """The outputs of one network, and how boxes are read from them."""

    family: Family
    outputs: tuple[str, ...]
    in_columns: bool = False
    shares: bool = False
    logits: bool = False
    corners: bool = False  # and a class after the score
    of_all_pictures: bool = False  # the picture's number, corners, a class, a score
    one_class: bool = False  # whose score is the objectness

    @property
    def overlaps(self) -> bool:
        """Whether several boxes of one object are left."""
        return self.family in ("YOLOv5", "YOLOv8")

    def rows(self, outputs: Sequence[Floats]) -> Floats:
        """A row for each box."""
        import numpy as np

        if self.of_all_pictures:
            (boxes,) = outputs
            return boxes[:, [1, 2, 3, 4, 6, 5]].astype(np.float32)
        parts = [output[0].astype(np.float32, copy=False) for output in outputs]
        rows: Floats = np.column_stack(parts) if len(parts) > 1 else parts[0]
        return rows.T if self.in_columns else rows

    def read(self, outputs: Sequence[Floats], *, size_px: tuple[int, int], confidence: float) -> Candidates:
        """The boxes that score above `confidence`, at most MOST_CANDIDATES, each of its best class.

        `size_px` are the picture's height and width. Boxes that are no numbers are left out.
        """
        import numpy as np

        rows = self.rows(outputs)
        with np.errstate(all="ignore"):  # outputs may be infinite
            if self.family == "YOLOv5":
                rows = rows[rows[:, 4] > confidence]  # low objectness spares the classes
            classes, scores = self._classes_of(rows)
            kept = (scores > confidence) & np.isfinite(rows[:, :4]).all(axis=1) & (classes >= 0)
            best = np.flatnonzero(kept)[np.argsort(-scores[kept], kind="stable")[:MOST_CANDIDATES]]
            height_px, width_px = size_px if self.shares else (1, 1)
            scale = np.array([width_px, height_px] * 2, np.float32)
            boxes = np.clip(rows[best, :4] * scale, -_FARTHEST_PX, _FARTHEST_PX)
        if not self.corners:
            centres, halves = boxes[:, :2], boxes[:, 2:] / 2
            boxes = np.hstack([centres - halves, centres + halves])
        return Candidates(boxes, np.minimum(scores[best], 1), classes[best])

    def _classes_of(self, rows: Floats) -> tuple[NDArray[np.intp], Floats]:
        """The best class of each row with its score."""
        import numpy as np

        if self.corners:
            known = (rows[:, 5] >= 0) & (rows[:, 5] < MOST_LABELS)
            return np.where(known, rows[:, 5], -1).astype(np.intp), rows[:, 4]
        if self.one_class:
            scores = rows[:, 4:5]
        else:
            scores = rows[:, 5:] * rows[:, 4:5] if self.family == "YOLOv5" else rows[:, 4:]
        best = scores.max(axis=1)
        return scores.argmax(axis=1), sigmoid(best) if self.logits else best


def recognise(outputs: Mapping[str, Floats], *, size_px: tuple[int, int], names: int) -> BoxHead:
    """The head of a network from its outputs for a grey picture of that height and width; raises ValueError."""
    import numpy as np

    found = {
        name: output
        for name, output in outputs.items()
        if output.ndim == 3 and len(output) == 1 and output.dtype.kind == "f" and output.size <= MOST_VALUES
    }
    three = _labels_apart(outputs)
    seven = _of_yolov7(outputs)
    # Old exports of YOLOv5 give its cells a second time, before decoding, with five dimensions.
    rest = (output for name, output in outputs.items() if name not in found)
    if not (three or seven) and (len(found) not in (1, 2) or any(output.ndim != 5 for output in rest)):
        raise ValueError(_not_known(outputs))
    if not all(np.isfinite(outputs[name]).all() for name in three or seven or found):
        raise ValueError(
            "some numbers of its outputs are infinite or none (NaN) for a grey picture: export it with 32-bit floats"
        )
    head: BoxHead | None
    if three:
        head = BoxHead("DETR", three, corners=True)
    elif seven:
        head = BoxHead("end-to-end", seven, corners=True, of_all_pictures=True)
    elif len(found) == 1:
        head = _recognise_one(*next(iter(found.items())), names)
    else:
        head = _recognise_two(found, names)
    if head is None:
        raise ValueError(_not_known(outputs))
    rows = head.rows([outputs[name] for name in head.outputs])
    if head.corners and (highest := int(rows[:, 5].max(initial=0))) >= names:
        raise ValueError(_wrong_names(f"output {head.outputs[-1]} has class {highest}", names))
    cells = sum((size_px[0] // stride) * (size_px[1] // stride) for stride in _STRIDES)
    # YOLOv6 has one box a cell too, and an objectness of 1.
    if head.family == "YOLOv5" and len(rows) == cells and (rows[:, 4] < 1).any():
        raise ValueError(
            f"its output has {len(rows)} cells of one box and an objectness, as of YOLOX, whose pictures and boxes "
            f"are others: {_OWN_SERVICE}"
        )
    scores = rows[:, 4:5] if head.corners else rows[:, 4:]
    if not head.logits and scores.size and not (scores.min() >= 0 and scores.max() <= 1.001):
        raise ValueError(
            f"its outputs are like those of {head.family} networks, but scores are from {scores.min():.3g} to "
            f"{scores.max():.3g}, not from 0 to 1: export it with decoded boxes, or {_OWN_SERVICE}"
        )
    # Training of YOLOv5 and v7 leaves the class out where there is one: its values say nothing. YOLOv6 has an
    # objectness of 1.
    if head.family == "YOLOv5" and names == 1 and (rows[:, 4] < 1).any():
        return replace(head, one_class=True)
    return head


def _recognise_one(name: str, values: Floats, names: int) -> BoxHead | None:
    """The head of a network with one output; raises ValueError for a number of names that does not fit."""
    import numpy as np

    _, height, width = values.shape
    if height == 4 + names and (width >= height or width not in (6, 4 + names, 5 + names)):
        return BoxHead("YOLOv8", (name,), in_columns=True, shares=_are_shares(values[0, :4]))
    rows = values[0]
    counts_classes = width == 6 and bool(
        (rows[:, 5] >= 0).all() and (rows[:, 5] == np.rint(rows[:, 5])).all()
    )
    if counts_classes and (not height or rows[:, 5].max() < names):
        return BoxHead("end-to-end", (name,), corners=True)
    shares = _are_shares(rows[:, :4])
    if width == 5 + names:
        return BoxHead("YOLOv5", (name,), shares=shares)
    if width == 4 + names:
        return BoxHead("DETR" if shares else "YOLOv8", (name,), shares=shares)
    shape = f"output {name} is {by(values.shape)}"
    if counts_classes:
        raise ValueError(
            _wrong_names(f"{shape}, as of an end-to-end head that has class {rows[:, 5].max():g}", names)
        )
    if 5 <= height < width:
        raise ValueError(_wrong_names(f"{shape}, as of YOLOv8 with {_classes(height - 4)}", names))
    if 5 <= width < height:
        ways = f"YOLOv5 with {_classes(width - 5)} or DETR with {_classes(width - 4)}"
        raise ValueError(_wrong_names(f"{shape}, as of {ways}", names))
    return None


def _labels_apart(outputs: Mapping[str, Floats]) -> tuple[str, ...]:
    """The names of the outputs of boxes, scores and labels; none of other outputs."""
    boxes = [name for name, output in outputs.items() if output.ndim == 3 and output.shape[2] == 4]
    scores = [name for name, output in outputs.items() if output.ndim == 2 and output.dtype.kind == "f"]
    labels = [name for name, output in outputs.items() if output.ndim == 2 and output.dtype.kind == "i"]
    names = (*boxes, *scores, *labels)
    if not len(boxes) == len(scores) == len(labels) == 1 or len(outputs) != len(names):
        return ()
    fits = all(outputs[name].shape[:2] == (1, outputs[boxes[0]].shape[1]) for name in names)
    return names if fits and outputs[boxes[0]].size <= MOST_VALUES else ()


def _of_yolov7(outputs: Mapping[str, Floats]) -> tuple[str, ...]:
    """The name of the only output if it is that of YOLOv7 with suppression: boxes of all pictures x 7."""
    return tuple(
        name
        for name, output in outputs.items()
        if len(outputs) == 1 and output.ndim == 2 and output.shape[1] == 7 and output.dtype.kind == "f"
    )


def _recognise_two(outputs: Mapping[str, Floats], names: int) -> BoxHead | None:
    """The head of a network that gives boxes and scores apart."""
    if set(outputs) == {"dets", "labels"}:
        return None  # RF-DETR, whose pictures are normalised otherwise
    fours = [name for name, output in outputs.items() if output.shape[2] == 4]
    boxes = next((name for name in fours if "box" in name), fours[0] if fours else "")
    scores = next(name for name in outputs if name != boxes)
    if not boxes or outputs[boxes].shape[1] != outputs[scores].shape[1] or not _are_shares(outputs[boxes]):
        return None
    if (classes := outputs[scores].shape[2]) != names:
        shape = f"output {scores} is {by(outputs[scores].shape)}"
        raise ValueError(_wrong_names(f"{shape}, as of DETR with {_classes(classes)}", names))
    logits = bool(((outputs[scores] < 0) | (outputs[scores] > 1)).any())
    return BoxHead("DETR", (boxes, scores), shares=True, logits=logits)


def _are_shares(boxes: Floats) -> bool:
    import numpy as np

    return boxes.size > 0 and bool(np.abs(boxes).max() <= _LARGEST_SHARE)


# --- messages --------------------------------------------------------------------------------------------

_OWN_SERVICE = "run it in a service of your own (docs/detector.md shows one of 20 lines)"


def _not_known(outputs: Mapping[str, Floats]) -> str:
    seen = ", ".join(f"{name}: {by(output.shape)} {output.dtype}" for name, output in outputs.items())
    return (
        f"its outputs are not understood ({seen}): boxes as of YOLOv5, YOLOv8 and later, end-to-end or DETR are, and "
        f"YOLOv3's raw heads if the setting heads describes them; {_OWN_SERVICE}"
    )


def _wrong_names(seen: str, names: int) -> str:
    there = "there is 1 name" if names == 1 else f"there are {names} names"
    return f"{seen}, but {there}: give names, a file with a line for each class"


def _classes(number: int) -> str:
    return counted(number, "class") if number == 1 else f"{number} classes"


def by(shape: Iterable[object]) -> str:
    """The shape as people write it."""
    return " x ".join(map(str, shape))


# --- names in the metadata -----------------------------------------------------------------------------------


def parse_names(text: str) -> list[str]:
    """The names of classes, as {0: 'person', 1: "cat"}, ['person', "cat"] or in JSON; raises ValueError."""
    text = text.strip()
    if len(text) > _MOST_NAMES_LETTERS or text[:1] + text[-1:] not in ("{}", "[]"):
        raise ValueError("no list of names")
    found = islice(_names_in(text[1:-1]), MOST_LABELS + 1)
    numbered = [(len(text) if not index else int(index), name) for index, name in found]
    names = [name.strip() for _, name in sorted(numbered, key=lambda item: item[0])]
    if text[0] == "{" and sorted(index for index, _ in numbered) != list(range(len(numbered))):
        raise ValueError(f"its numbers are not those from 0 to {len(numbered) - 1}")
    if not 0 < len(names) <= MOST_LABELS or not all(names):
        raise ValueError("an empty name, no names or too many")
    return names


def _names_in(text: str) -> Iterator[tuple[str | None, str]]:
    at = 0
    text = text.rstrip()
    while at < len(text):
        if (match := _NAME.match(text, at)) is None:
            raise ValueError(f"no name at letter {at + 2}")
        try:
            yield match[1], ast.literal_eval(match[2])  # a string alone
        except SyntaxError as error:
            raise ValueError(f"no name at letter {at + 2}: {error.msg}") from error
        at = match.end()
