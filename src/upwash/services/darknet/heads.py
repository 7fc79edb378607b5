"""The heads of YOLOv3: outputs for each cell and anchor become scored boxes, then the best box of each object.

A head is an output of shape 1, anchors x (5 + classes), rows, columns. For each anchor its channels are x, y, width,
height, objectness and the classes, as the last convolution leaves them (J. Redmon, A. Farhadi, "YOLOv3", 2018).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import msgspec
from msgspec import Meta

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

HEADS_METADATA = "upwash.heads"  # the key in an ONNX model's metadata
MOST_CANDIDATES = 1000
_MOST_OVERLAP = 0.45
_STEEPEST = 30.0  # beyond, a sigmoid is 0 or 1, and a box exceeds any picture

Pixels = Annotated[float, Meta(gt=0, description="a number of pixels above 0")]


class Head(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One output of a network: its name, the input pixels behind a cell, and its anchors' widths and heights."""

    output: str
    stride: Annotated[int, Meta(ge=1, description="an integer of at least 1, in pixels")]
    anchors: Annotated[
        tuple[tuple[Pixels, Pixels], ...],
        Meta(
            min_length=1, description="pairs [width, height] in pixels of the network's input, at least one"
        ),
    ]


def encode_heads(heads: Iterable[Head]) -> str:
    """The heads as JSON for the metadata of a model."""
    return msgspec.json.encode(list(heads)).decode()


def decode_heads(metadata: str) -> tuple[Head, ...]:
    """The heads of a model from its metadata; raises msgspec.MsgspecError."""
    return msgspec.json.decode(metadata, type=tuple[Head, ...])


@dataclass(frozen=True, slots=True)
class Candidates:
    """Scored boxes, best first: left, top, right, bottom in pixels of the network's input."""

    boxes: Floats  # n, 4
    scores: Floats  # n
    classes: NDArray[np.intp]  # n

    def only(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> Candidates:
        """The chosen ones."""
        return Candidates(self.boxes[chosen], self.scores[chosen], self.classes[chosen])


def read_heads(outputs: Sequence[Floats], heads: Sequence[Head], *, confidence: float) -> Candidates:
    """The boxes that score above `confidence`, at most MOST_CANDIDATES, from the outputs of the heads."""
    import numpy as np

    read = [_read_head(output, head, confidence) for output, head in zip(outputs, heads, strict=True)]
    found = Candidates(
        np.concatenate([one.boxes for one in read]),
        np.concatenate([one.scores for one in read]),
        np.concatenate([one.classes for one in read]),
    )
    return found.only(np.argsort(-found.scores, kind="stable")[:MOST_CANDIDATES])


def _read_head(output: Floats, head: Head, confidence: float) -> Candidates:
    import numpy as np

    anchors = np.array(head.anchors, np.float32)
    _, _, rows, columns = output.shape
    values = output.reshape(len(anchors), -1, rows, columns)
    # A score is objectness times class: low objectness spares the classes.
    anchor, row, column = np.nonzero(sigmoid(values[:, 4]) > confidence)
    there = values[anchor, :, row, column]
    scores = sigmoid(there[:, 4:5]) * sigmoid(there[:, 5:])
    which, classes = np.nonzero(scores > confidence)
    cells = np.stack([column, row], axis=1)[which].astype(np.float32)
    centres = (sigmoid(there[which, 0:2]) + cells) * head.stride
    halves = np.exp(np.clip(there[which, 2:4], -_STEEPEST, _STEEPEST)) * anchors[anchor[which]] / 2
    return Candidates(np.hstack([centres - halves, centres + halves]), scores[which, classes], classes)


def best_of_each(found: Candidates) -> Candidates:
    """The best box of each object: boxes of one class overlap by at most 45 % (intersection over union)."""
    import numpy as np

    left, top, right, bottom = found.boxes.T
    areas = (right - left) * (bottom - top)
    kept = np.ones(len(areas), np.bool_)
    for index in range(len(areas)):
        if not kept[index]:
            continue
        rest = np.s_[index + 1 :]
        width = np.minimum(right[index], right[rest]) - np.maximum(left[index], left[rest])
        height = np.minimum(bottom[index], bottom[rest]) - np.maximum(top[index], top[rest])
        shared = np.maximum(width, 0) * np.maximum(height, 0)
        too_near = shared > _MOST_OVERLAP * (areas[index] + areas[rest] - shared)
        kept[rest] &= ~(too_near & (found.classes[rest] == found.classes[index]))
    return found.only(kept)


def sigmoid(numbers: Floats) -> Floats:
    """Shares from 0 to 1 of any numbers."""
    import numpy as np

    shares: Floats = np.reciprocal(1 + np.exp(-np.clip(numbers, -_STEEPEST, _STEEPEST)))
    return shares
