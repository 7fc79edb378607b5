"""Scores a detector on rendered photos: `python -m training.evaluate`; see README.md beside this file.

The photos go through the service itself, from JPEG to boxes, so that the scores are those of what is flown.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from rich.console import Console
from rich.progress import track
from rich.table import Table

from training.photos import TEST_SEEDS, VALIDATION_SEEDS
from training.scoring import Judged, average_precision, precision, recall
from upwash.services import Detection, Detector, Mode, ModelFiles
from upwash.services.detector import SOLAR_PARK
from upwash.services.solar_park import LABELS, RenderedPhoto, TrueBox, render_photo

_SEEDS = {"validation": VALIDATION_SEEDS, "test": TEST_SEEDS}
_LEAST_CONFIDENCE = 0.001
_USUAL_CONFIDENCE = 0.25  # the service's, unless it is told another
_SIZES_PX = (0, 10, 16, 32, 1440)  # of the longer side


@dataclass(frozen=True, slots=True)
class _Looked:
    truth: tuple[TrueBox, ...]
    found: dict[Mode, list[Detection]]


def main() -> None:
    """Prints a table of the scores by mode and label."""
    arguments = _arguments()
    detector = Detector(model=arguments.model)
    seeds = _SEEDS[arguments.photos][: arguments.first]
    photos = [
        _Looked(photo.truth, {mode: _look(detector, photo, mode) for mode in get_args(Mode)})
        for photo in track(_rendered(seeds), arguments.photos, total=len(seeds))
    ]
    console = Console()
    console.print(_scores(photos))
    console.print(_found_by_size(photos))


def _look(detector: Detector, photo: RenderedPhoto, mode: Mode) -> list[Detection]:
    return detector.process_photo(photo.jpeg, mode, confidence=_LEAST_CONFIDENCE)


def _rendered(seeds: range) -> Iterable[RenderedPhoto]:
    with multiprocessing.get_context("spawn").Pool(os.cpu_count()) as pool:
        yield from pool.imap(render_photo, seeds, chunksize=2)


def _judged(photos: Sequence[_Looked], mode: Mode, label: str) -> list[Judged]:
    return [
        Judged(
            [each for each in photo.found[mode] if each.label == label],
            [box for box in photo.truth if box.label == label],
        )
        for photo in photos
    ]


def _scores(photos: Sequence[_Looked]) -> Table:
    table = Table(
        "mode",
        "label",
        "boxes",
        "AP50",
        "precision",
        "recall",
        title=f"precision and recall at {_USUAL_CONFIDENCE}",
    )
    for mode in get_args(Mode):
        averages = []
        for label in LABELS:
            judged = _judged(photos, mode, label)
            averages.append(average_precision(judged))
            table.add_row(
                mode,
                label,
                str(sum(len(photo.truth) for photo in judged)),
                f"{averages[-1]:.3f}",
                f"{precision(judged, confidence=_USUAL_CONFIDENCE):.3f}",
                f"{recall(judged, confidence=_USUAL_CONFIDENCE):.3f}",
            )
        table.add_row(mode, "mean", "", f"{sum(averages) / len(averages):.3f}", end_section=True)
    return table


def _found_by_size(photos: Sequence[_Looked]) -> Table:
    """How many of the hot-spots of each size are found at the usual confidence."""
    table = Table("longer side", "hot-spots", *get_args(Mode), title="hot-spots found, by size")
    for at_least, below in itertools.pairwise(_SIZES_PX):
        row = []
        for mode in get_args(Mode):
            sized = [
                Judged(
                    photo.found,
                    [box for box in photo.truth if at_least <= max(box.width_px, box.height_px) < below],
                )
                for photo in _judged(photos, mode, "hot-spot")
            ]
            count = sum(len(photo.truth) for photo in sized)
            row.append(f"{recall(sized, confidence=_USUAL_CONFIDENCE):.3f}" if count else "-")
        table.add_row(f"{at_least} to {below} px", str(count), *row)
    return table


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("photos", choices=_SEEDS, nargs="?", default="validation")
    parser.add_argument("--first", type=int, metavar="N", help="score the first photos only")
    parser.add_argument(
        "--model",
        type=_model,
        default=SOLAR_PARK,
        help="a model's files without their endings; default: the default model",
    )
    return parser.parse_args()


def _model(stem: str) -> ModelFiles:
    path = Path(stem)
    return ModelFiles(
        cfg=path.with_suffix(".cfg"), weights=path.with_suffix(".weights"), names=path.with_suffix(".names")
    )


if __name__ == "__main__":
    main()
