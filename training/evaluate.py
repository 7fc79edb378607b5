"""Scores a detector on rendered photos: `python -m training.evaluate`; see README.md beside this file.

The photos go through the service itself, from JPEG to boxes, so that the scores are those of what is flown.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import multiprocessing
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from training.photos import ALTITUDE_SEEDS, ALTITUDES_M, TEST_SEEDS, VALIDATION_SEEDS
from training.scoring import Judged, Ranking, average_precision, precision, recall
from upwash.services import Detection, Detector, Mode, ModelFiles
from upwash.services.detector import SOLAR_PARK
from upwash.services.solar_park import LABELS, RenderedPhoto, TrueBox, render_photo

_SEEDS = {"validation": VALIDATION_SEEDS, "test": TEST_SEEDS}
_LEAST_CONFIDENCE = 0.001
_USUAL_CONFIDENCE = 0.25  # the default of the service
_SIZES_PX = (0, 10, 16, 32, 1440)  # of the longer side
_ALTITUDES = "altitudes"
_RESAMPLES = 2000
_INTERVAL_PERCENT = (2.5, 97.5)


@dataclass(frozen=True, slots=True)
class _Looked:
    truth: tuple[TrueBox, ...]
    found: dict[Mode, list[Detection]]


def main() -> None:
    """Prints a table of the scores by mode and label, or by altitude."""
    arguments = _arguments()
    detector = Detector(model=arguments.model)
    console = Console()
    if arguments.photos == _ALTITUDES:
        seeds = ALTITUDE_SEEDS[: arguments.first]
        console.print(
            _scores_by_altitude({each: _looked(detector, seeds, altitude_m=each) for each in ALTITUDES_M})
        )
        return
    photos = _looked(detector, _SEEDS[arguments.photos][: arguments.first])
    console.print(_scores(photos))
    console.print(_found_by_size(photos))


def _looked(detector: Detector, seeds: range, *, altitude_m: float | None = None) -> list[_Looked]:
    what = "photos" if altitude_m is None else f"photos from {altitude_m} m"
    return [
        _Looked(photo.truth, {mode: _look(detector, photo, mode) for mode in get_args(Mode)})
        for photo in track(_rendered(seeds, altitude_m), what, total=len(seeds))
    ]


def _look(detector: Detector, photo: RenderedPhoto, mode: Mode) -> list[Detection]:
    return detector.process_photo(photo.jpeg, mode, confidence=_LEAST_CONFIDENCE)


def _rendered(seeds: range, altitude_m: float | None) -> Iterable[RenderedPhoto]:
    with multiprocessing.get_context("spawn").Pool(os.cpu_count()) as pool:
        yield from pool.imap(functools.partial(render_photo, altitude_m=altitude_m), seeds, chunksize=2)


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


def _scores_by_altitude(photos: dict[int, list[_Looked]]) -> Table:
    """The mean AP50 of both modes from each altitude, and by how much heavy is better."""
    table = Table(
        "altitude",
        "hot-spots",
        "below 10 px",
        "light hot-spot",
        "heavy hot-spot",
        "light mean",
        "heavy mean",
        "heavy - light",
        title="AP50 by altitude; brackets hold 95 % of what photos drawn anew from these give",
    )
    for altitude_m, looked in photos.items():
        sides_px = [max(box.width_px, box.height_px) for box in _truth(looked, "hot-spot")]
        weights = _resamples(len(looked))
        spots = [_resampled(looked, mode, LABELS[:1], weights) for mode in get_args(Mode)]
        light, heavy = (_resampled(looked, mode, LABELS, weights) for mode in get_args(Mode))
        table.add_row(
            f"{altitude_m} m",
            str(len(sides_px)),
            f"{np.mean(np.array(sides_px) < _SIZES_PX[1]):.0%}" if sides_px else "-",
            *(f"{each[0]:.3f}" for each in (*spots, light, heavy)),
            _with_interval(heavy - light),
        )
    return table


def _truth(photos: Sequence[_Looked], label: str) -> list[TrueBox]:
    return [box for photo in photos for box in photo.truth if box.label == label]


def _resamples(photos: int) -> NDArray[np.intp]:
    """How often each photo is taken: each once in the first row, in the others as chance has it."""
    drawn = np.random.default_rng(1).multinomial(photos, np.full(photos, 1 / photos), _RESAMPLES)
    return np.vstack([np.ones(photos, np.intp), drawn])


def _resampled(
    photos: Sequence[_Looked], mode: Mode, labels: Sequence[str], weights: NDArray[np.intp]
) -> NDArray[np.float64]:
    """The mean AP50 of the labels, for each row of weights."""
    rankings = [Ranking.of(_judged(photos, mode, label)) for label in labels]
    return np.array(
        [np.mean([ranking.average_precision(row) for ranking in rankings]) for row in weights], np.float64
    )


def _with_interval(scores: NDArray[np.float64]) -> str:
    """The first of the scores, and what the middle of all others lies between."""
    low, high = np.percentile(scores[1:], _INTERVAL_PERCENT)
    return f"{scores[0]:.3f} [{low:.3f}, {high:.3f}]"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("photos", choices=(*_SEEDS, _ALTITUDES), nargs="?", default="validation")
    parser.add_argument(
        "--first", type=int, metavar="N", help="score the first photos only (of each altitude)"
    )
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
