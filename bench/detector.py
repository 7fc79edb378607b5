"""What the detector costs: `python -m bench.detector`.

From a photo's bytes to its boxes, against the network alone and the JPEG's decoding, for the bundled network and for
YOLOv3 at full size. YOLOv3 has random weights: its times count, its boxes mean nothing. See docs/science.md.
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import TypeVar

import cv2
import numpy as np
import onnxruntime
from bench.program import command_line, machine
from tests.services.darknet_models import write_labels, write_model, yolov3

from upwash.services import Detector, Mode, ModelFiles
from upwash.services.darknet.conversion import converted
from upwash.services.detector import SOLAR_PARK
from upwash.services.photo import read_photo
from upwash.services.solar_park import render_photo

T = TypeVar("T")

PHOTO_SEED = 1
THREADS = os.cpu_count() or 1
MOST_OVER_BARE = 1.15
SIDES_PX: Mapping[Mode, int] = {"light": 320, "heavy": 608}
DECODED_AT = {"light": cv2.IMREAD_REDUCED_COLOR_4, "heavy": cv2.IMREAD_REDUCED_COLOR_2}


@dataclass(frozen=True)
class Contest:
    """A model, how often each way is measured, and above which score a box counts."""

    title: str
    files: ModelFiles
    cell_px: int  # the network's largest stride
    rounds: int
    confidence: float


@dataclass(frozen=True)
class Delays:
    """Seconds of one mode by round, in the order of measurement."""

    whole_s: list[float]
    network_s: list[float]
    decoding_s: list[float]
    boxes: int

    @property
    def over_bare(self) -> float:
        """The median of a round's whole over its network and its decoding."""
        rounds = zip(self.whole_s, self.network_s, self.decoding_s, strict=True)
        return median(whole / (network + decoding) for whole, network, decoding in rounds)


def main() -> None:
    """Measures and prints; a missed limit is printed as such and is no failure."""
    quick = command_line("detector", __doc__).parse_args().quick
    photo = render_photo(PHOTO_SEED).jpeg
    print(f"photo of 1440 x 1080 pixels, {len(photo)} bytes; {THREADS} threads; {machine()}")
    with tempfile.TemporaryDirectory(prefix="upwash-bench-") as name:
        os.environ["XDG_CACHE_HOME"] = f"{name}/cache"
        for contest in quick_contests() if quick else contests(Path(name)):
            report(contest, in_a_process(first_start, contest, photo), in_a_process(measure, contest, photo))


def contests(folder: Path) -> Iterator[Contest]:
    """Those that are measured."""
    yield Contest("bundled network", SOLAR_PARK, 16, rounds=40, confidence=0.25)
    # What random numbers "find" means nothing, and there is too much of it: a score that none reaches.
    yield Contest(
        "YOLOv3, random weights (timing only)", random_yolov3(folder), 32, rounds=10, confidence=1.0
    )


def quick_contests() -> Iterator[Contest]:
    """The bundled network alone: YOLOv3 takes a minute to make."""
    yield Contest("bundled network", SOLAR_PARK, 16, rounds=1, confidence=0.25)


def random_yolov3(folder: Path) -> ModelFiles:
    """YOLOv3 as published, with random weights."""
    cfg, weights = write_model(folder, yolov3())
    return ModelFiles(cfg=cfg, weights=weights, names=write_labels(folder, 80))


def report(contest: Contest, first_s: float, measured: tuple[dict[Mode, Delays], float, int]) -> None:
    """Prints a table of medians, what a start takes, and whether the limit holds."""
    by_mode, start_s, peak_bytes = measured
    print(f"\n{contest.title}, {contest.rounds} rounds")
    print(f"{'':8}{'photo to boxes':>16}{'network alone':>16}{'decoding':>12}{'ratio':>8}{'boxes':>8}")
    for mode, delays in by_mode.items():
        columns = [median(each) * 1e3 for each in (delays.whole_s, delays.network_s, delays.decoding_s)]
        print(
            f"{mode:8}{columns[0]:>13.1f} ms{columns[1]:>13.1f} ms{columns[2]:>9.1f} ms{delays.over_bare:>8.3f}"
            f"{delays.boxes:>8}"
        )
    print(
        f"start: {first_s:.2f} s the first time, {start_s:.2f} s from the cache; "
        f"peak memory {peak_bytes / 2**20:.0f} MiB"
    )
    ratio = by_mode["heavy"].over_bare
    verdict = "PASS" if ratio <= MOST_OVER_BARE else "MISS"
    print(f"{verdict}: heavy / (network + decoding) = {ratio:.3f}, at most {MOST_OVER_BARE:.2f}")


# --- one measurement, in a process of its own ---------------------------------------------------------------


def in_a_process(measurement: Callable[[Contest, bytes], T], contest: Contest, photo: bytes) -> T:
    """What a measurement finds in a process that does nothing else, so that its memory is its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(measurement, contest, photo).result()


def first_start(contest: Contest, _: bytes) -> float:
    """How long a detector takes until it is ready when its model was never converted before."""
    began_s = time.perf_counter()
    Detector(model=contest.files, threads=THREADS)
    return time.perf_counter() - began_s


def measure(contest: Contest, photo: bytes) -> tuple[dict[Mode, Delays], float, int]:
    """The delays by mode, how long the start took, and the most memory that the detector alone needed."""
    began_s = time.perf_counter()
    detector = Detector(model=contest.files, threads=THREADS)
    start_s = time.perf_counter() - began_s
    for mode in SIDES_PX:
        detector.process_photo(photo, mode, contest.confidence)
    peak_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    session = bare_session(contest.files)
    return {mode: race(contest, detector, session, photo, mode) for mode in SIDES_PX}, start_s, peak_bytes


def bare_session(files: ModelFiles) -> onnxruntime.InferenceSession:
    """The same network in a session of its own, with as many threads."""
    assert files.cfg is not None
    assert files.weights is not None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = THREADS
    with converted(files.cfg, files.weights) as model:
        return onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])


def race(
    contest: Contest, detector: Detector, session: onnxruntime.InferenceSession, photo: bytes, mode: Mode
) -> Delays:
    """The three ways in turn: the whole, the network alone on a ready picture, the decoding alone."""
    picture, _ = read_photo(photo, SIDES_PX[mode], contest.cell_px)
    encoded = np.frombuffer(photo, np.uint8)
    name = session.get_inputs()[0].name
    ways: dict[str, Callable[[], object]] = {
        "whole": lambda: detector.process_photo(photo, mode, contest.confidence),
        "network": lambda: session.run(None, {name: picture}),
        "decoding": lambda: cv2.imdecode(encoded, DECODED_AT[mode]),
    }
    delays_s: dict[str, list[float]] = {way: [] for way in ways}
    for number in range(contest.rounds + 1):
        for way, call in ways.items():
            began_s = time.perf_counter()
            call()
            if number:  # the first round warms up
                delays_s[way].append(time.perf_counter() - began_s)
    boxes = len(detector.process_photo(photo, mode, contest.confidence))
    return Delays(delays_s["whole"], delays_s["network"], delays_s["decoding"], boxes)


if __name__ == "__main__":
    main()
