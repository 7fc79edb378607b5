"""The layouts of the outputs of networks that decode their boxes themselves, and a decoder for each.

The sources are exporters: of Ultralytics (YOLOv3 to YOLO26, RT-DETR), of the authors of YOLOv5, v6, v7, RT-DETR and
D-FINE, and of super-gradients (YOLO-NAS). Those of transformers make DETR, YOLOS, Conditional DETR, RT-DETR and
D-FINE. YOLOv3's raw heads, which need anchors, are in `darknet/heads.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

from upwash.services.darknet.heads import sigmoid

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]
    Outputs = Mapping[str, Floats]  # of one picture, by name

Family = Literal["YOLOv5", "YOLOv8", "end-to-end", "DETR"]

_LARGEST_SHARE = 2.0  # of the picture: a larger number is one of pixels
_HIGHEST_SCORE = 1.001  # 16-bit floats round
_FEW = 0.05  # of the boxes, which a network may leave with corners in the wrong order


class ScoredBoxes(NamedTuple):
    """The boxes of a picture: n x 4, with the scores of all classes, n x k, or of the class that each has, n x 1."""

    boxes: Floats
    scores: Floats
    classes: Floats | None = None


# --- decoders: from outputs in the order of their layout to rows -------------------------------------------------

Decoder = Callable[
    [Sequence["Floats"], float], ScoredBoxes
]  # rows with no more objectness than this may be left out


def scored(outputs: Sequence[Floats], least: float) -> ScoredBoxes:
    """A row has a box and the scores of all classes."""
    return ScoredBoxes(outputs[0][0, :, :4], outputs[0][0, :, 4:])


def in_columns(outputs: Sequence[Floats], least: float) -> ScoredBoxes:
    """The same in columns."""
    return ScoredBoxes(outputs[0][0, :4].T, outputs[0][0, 4:].T)


def with_objectness(outputs: Sequence[Floats], least: float) -> ScoredBoxes:
    """The score of a class is a share of the objectness."""
    (rows,) = outputs[0]
    rows = rows[rows[:, 4] > least]
    return ScoredBoxes(rows[:, :4], rows[:, 5:] * rows[:, 4:5])


def objectness_alone(outputs: Sequence[Floats], least: float) -> ScoredBoxes:
    """The score of the only class is the objectness."""
    return ScoredBoxes(outputs[0][0, :, :4], outputs[0][0, :, 4:5])


def chosen(outputs: Sequence[Floats], least: float) -> ScoredBoxes:
    """A row has a box, a score and a class."""
    return ScoredBoxes(outputs[0][0, :, :4], outputs[0][0, :, 4:5], outputs[0][0, :, 5])


def of_all_pictures(outputs: Sequence[Floats], least: float) -> ScoredBoxes:
    """A row has the picture's number, a box, then class and score (YOLOv7) or score and class (YOLO-NAS)."""
    (rows,) = outputs
    score, cls = (6, 5) if are_classes(rows[:, 5]) else (5, 6)
    return ScoredBoxes(rows[:, 1:5], rows[:, score : score + 1], rows[:, cls])


def labels_apart(outputs: Sequence[Floats], least: float) -> ScoredBoxes:
    """Boxes, scores and classes are outputs of their own."""
    return ScoredBoxes(outputs[0][0], outputs[1][0, :, None], outputs[2][0])


def scores_apart(outputs: Sequence[Floats], least: float) -> ScoredBoxes:
    """Boxes and the scores of all classes are outputs of their own."""
    return ScoredBoxes(outputs[0][0], outputs[1][0])


def logits_apart(outputs: Sequence[Floats], least: float) -> ScoredBoxes:
    """The same before a sigmoid."""
    return ScoredBoxes(outputs[0][0], sigmoid(outputs[1][0]))


def logits_with_none_apart(outputs: Sequence[Floats], least: float) -> ScoredBoxes:
    """The same before a softmax, or after it; the last class is "no object"."""
    import numpy as np

    scores = outputs[1][0]
    if not are_scores(scores):
        scores = np.exp(scores - scores.max(axis=1, keepdims=True))
        scores /= scores.sum(axis=1, keepdims=True)
    return ScoredBoxes(outputs[0][0], scores[:, :-1])


# --- what the values have to be, where shapes alone do not tell layouts apart -------------------------------------


def are_classes(values: Floats) -> bool:
    """Whether all values are whole numbers from 0."""
    import numpy as np

    return bool((values >= 0).all() and (values == np.rint(values)).all())


def are_scores(values: Floats) -> bool:
    """Whether all values are from 0 to 1."""
    return bool(((values >= 0) & (values <= _HIGHEST_SCORE)).all())


def are_shares(boxes: Floats) -> bool:
    """Whether the boxes are in shares of the picture, and not in pixels."""
    import numpy as np

    return bool(boxes.any() and np.abs(boxes).max() <= _LARGEST_SHARE)


def are_mostly_none(scores: Floats, *, last: bool = True) -> bool:
    """Whether the last class, or the first, is the surest of most boxes, as "no object" is where there is none."""
    which = scores.shape[-1] - 1 if last else 0
    surest = scores.argmax(axis=-1) == which
    return scores.shape[-1] > 1 and bool(surest.mean() > 0.5 and scores[..., which].max() > 0.5)


def _counts(given: Sequence[Floats], names: int) -> bool:
    classes = given[0][..., 5]
    return are_classes(classes) and bool(classes.max(initial=0) < names)


def _counts_centres(given: Sequence[Floats], names: int) -> bool:
    boxes = given[0][..., :4]
    turned = (boxes[..., 2:] < boxes[..., :2]).any(axis=-1)
    return _counts(given, names) and are_shares(boxes) and bool(turned.mean() > _FEW)


def _shares(given: Sequence[Floats], names: int) -> bool:
    return are_shares(given[0][..., :4])


def _none(given: Sequence[Floats], names: int) -> bool:
    return are_shares(given[0]) and are_mostly_none(given[1])


def _scores(given: Sequence[Floats], names: int) -> bool:
    return are_shares(given[0]) and are_scores(given[1]) and not are_mostly_none(given[1])


def _logits(given: Sequence[Floats], names: int) -> bool:
    return are_shares(given[0]) and not are_scores(given[1]) and not are_mostly_none(given[1])


# --- the table ----------------------------------------------------------------------------------------------------


class Layout(NamedTuple):
    """The outputs of a family, each by its kind and its lengths (n boxes, C names), and how boxes are read from them.

    Where the shapes fit, `holds` decides by the outputs for all test pictures and the number of names.
    """

    family: Family
    outputs: tuple[str, ...]
    decode: Decoder
    holds: Callable[[Sequence[Floats], int], bool] = lambda given, names: True
    corners: bool = False
    normalised: bool = False  # pictures, by the means and deviations of ImageNet


LAYOUTS = (
    Layout("DETR", ("f 1 n 6",), chosen, _counts_centres),  # RT-DETR of Ultralytics
    Layout("end-to-end", ("f 1 n 6",), chosen, _counts, corners=True),
    Layout("end-to-end", ("f n 7",), of_all_pictures, corners=True),
    Layout("end-to-end", ("f 1 n 4", "f 1 n", "i 1 n", "i 1 1"), labels_apart, corners=True),
    Layout("DETR", ("f 1 n 4", "f 1 n", "i 1 n"), labels_apart, corners=True),
    Layout("YOLOv8", ("f 1 4+C n",), in_columns),
    Layout("YOLOv5", ("f 1 n 5+C",), with_objectness),
    Layout("DETR", ("f 1 n 4+C",), scored, _shares),
    Layout("YOLOv8", ("f 1 n 4+C",), scored),
    Layout("DETR", ("f 1 n 4", "f 1 n C"), scores_apart, _scores),
    Layout("DETR", ("f 1 n 4", "f 1 n C"), logits_apart, _logits),
    Layout("DETR", ("f 1 n 4", "f 1 n C+1"), logits_with_none_apart, _none, normalised=True),  # DETR, YOLOS
    Layout(
        "DETR", ("f 1 n 4", "f 1 n C"), logits_with_none_apart, _none, normalised=True
    ),  # "none" has a name
)


def placed(layout: Layout, outputs: Outputs, names: int) -> tuple[str, ...]:
    """The names of the outputs in the order of the layout; none if their shapes are others."""
    lengths = {"C": names, "C+1": names + 1, "4+C": 4 + names, "5+C": 5 + names}
    left = sorted(outputs, key=lambda name: "box" not in name)
    found: list[str] = []
    for wanted in layout.outputs:
        kind, *sides = wanted.split()
        for name in left:
            here = dict(zip(sides, outputs[name].shape, strict=False))
            if (outputs[name].dtype.kind, outputs[name].ndim) == (kind, len(sides)) and all(
                length == (lengths.get(side, length) if side in lengths or side == "n" else int(side))
                for side, length in here.items()
            ):
                found.append(name)
                left.remove(name)
                lengths |= {side: length for side, length in here.items() if side == "n"}
                break
    return tuple(found) if not left and len(found) == len(layout.outputs) else ()
