"""What a detector found in a person's photos, in one line: boxes, scores, and the share of photos with boxes."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from upwash.profiling.agreement import detections
from upwash.support.text import counted


def told_boxes(operation: str, answers: Sequence[object], *, as_chance: bool) -> str:
    """The line for the answers to different photos; empty for answers that are no detections.

    With `as_chance` the share of photos with boxes is the chance of an act at a waypoint, by the configuration's key.
    """
    found = [boxes for answer in answers if (boxes := detections(answer)) is not None]
    if not found or len(found) != len(answers):
        return ""
    scores = [box.score for boxes in found for box in boxes]
    with_boxes = sum(map(bool, found))
    said = f"{operation}: {counted(len(scores), 'box')} in {with_boxes} of {counted(len(found), 'photo')}"
    if scores:
        said += f", scores {min(scores):.2f} to {max(scores):.2f}, median {statistics.median(scores):.2f}"
    return f"{said}; in [event]: probability = {with_boxes / len(found):.2g}" if as_chance else said
