"""How many answers a part before sending costs: by what the whole photos' answers say, or by labels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from upwash.errors import UsageError
from upwash.services.detection import Box, Detection
from upwash.support.input_files import read_named_text
from upwash.support.text import number_of

HIT_OVERLAP = 0.5
_CLASSES = "classes.txt"
_MOST_BYTES = 1_000_000


class LabelledBox(Box, frozen=True, kw_only=True):
    """What is in a photo, by a person's label."""

    label: str


def lost(whole: Sequence[object], less: Sequence[object]) -> float:
    """The share of answers that differ with less to send, from 0 to 1; the answers are in the order of the photos.

    Of detections it is one minus the share of boxes, counted in both answers, that agree: of the same label, with an
    overlap of at least one half.
    """
    if not all(detections(answer) is not None for answer in (*whole, *less)):
        return sum(one != other for one, other in zip(whole, less, strict=True)) / len(whole)
    pairs = [(detections(one) or [], detections(other) or []) for one, other in zip(whole, less, strict=True)]
    boxes = sum(len(one) + len(other) for one, other in pairs)
    hits = sum(hit for one, other in pairs for _, hit in verdicts(other, one))
    return 1 - 2 * hits / boxes if boxes else 0.0


def mean_ap50(answers: Sequence[object], truth: Sequence[Sequence[LabelledBox]]) -> float:
    """The mean over labels of the average precision at an overlap of one half; the answers are detections."""
    found = [detections(answer) or [] for answer in answers]
    labels = sorted({box.label for boxes in truth for box in boxes})
    return sum(_average_precision(found, truth, label) for label in labels) / len(labels) if labels else 0.0


def verdicts(found: Sequence[Detection], truth: Sequence[Box]) -> list[tuple[float, bool]]:
    """The score of each detection, and whether it is a hit, best first; a box is hit once.

    Where boxes of the truth have labels, only the same label is a hit.
    """
    missed, judged = list(truth), []
    for each in sorted(found, key=lambda detection: -detection.score):
        same = [box for box in missed if getattr(box, "label", each.label) == each.label]
        best = max(same, key=lambda box: overlap(each, box), default=None)
        hit = best is not None and overlap(each, best) >= HIT_OVERLAP
        if hit and best is not None:
            missed.remove(best)
        judged.append((each.score, hit))
    return judged


def overlap(a: Box, b: Box) -> float:
    """The area that two boxes share over the area that they cover (IoU), 0 to 1."""
    width_px = min(a.left_px + a.width_px, b.left_px + b.width_px) - max(a.left_px, b.left_px)
    height_px = min(a.top_px + a.height_px, b.top_px + b.height_px) - max(a.top_px, b.top_px)
    shared_px = max(0.0, width_px) * max(0.0, height_px)
    covered_px = a.width_px * a.height_px + b.width_px * b.height_px - shared_px
    return shared_px / covered_px if covered_px else 0.0


def read_labels(folder: Path, sizes_px: Mapping[str, tuple[int, int]]) -> dict[str, list[LabelledBox]]:
    """The boxes of each photo, by the photo's name, from a folder as YOLO has them; raises UsageError.

    A photo of these sizes has a text file of its name, with a line `class x y width height` for each box, in shares
    of the photo, and no file if it shows nothing; classes.txt has the name of each class in a line.
    """
    names = read_named_text(folder / _CLASSES, most_bytes=_MOST_BYTES).splitlines()
    return {
        photo: list(_boxes(folder / f"{Path(photo).stem}.txt", names, size_px))
        for photo, size_px in sizes_px.items()
    }


def _boxes(file: Path, names: Sequence[str], size_px: tuple[int, int]) -> Iterator[LabelledBox]:
    if not file.exists():
        return
    for number, line in enumerate(read_named_text(file, most_bytes=_MOST_BYTES).splitlines(), start=1):
        try:
            index, *shares = line.split()
            x, y, width, height = map(number_of, shares)
            label = dict(enumerate(names))[int(number_of(index))].strip()
        except (ValueError, KeyError):
            raise UsageError(
                f"{file}, line {number}: {line[:60]!r} is no box: write `class x y width height`, a number of a line "
                f"of {_CLASSES} from 0 and four shares of the photo"
            ) from None
        wide_px, high_px = size_px
        yield LabelledBox(
            left_px=(x - width / 2) * wide_px,
            top_px=(y - height / 2) * high_px,
            width_px=width * wide_px,
            height_px=height * high_px,
            label=label,
        )


def _average_precision(
    found: Sequence[Sequence[Detection]], truth: Sequence[Sequence[LabelledBox]], label: str
) -> float:
    """The area below precision over recall, with precision made to fall steadily."""
    judged: list[tuple[float, bool]] = []
    boxes = 0
    for answer, its in zip(found, truth, strict=True):
        own = [box for box in its if box.label == label]
        boxes += len(own)
        judged += verdicts([each for each in answer if each.label == label], own)
    judged.sort(key=lambda verdict: -verdict[0])
    hits, precisions = 0, []
    for count, (_, hit) in enumerate(judged, start=1):
        hits += hit
        precisions.append(hits / count)
    area = best = 0.0
    for precision, (_, hit) in zip(reversed(precisions), reversed(judged), strict=True):
        best = max(best, precision)
        area += best * hit
    return area / boxes


def detections(answer: object) -> list[Detection] | None:
    """The answer as detections; None if it is none."""
    if isinstance(answer, list) and all(isinstance(each, Detection) for each in answer):
        return answer
    return None
