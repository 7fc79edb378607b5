"""What tiles find and cost on large photos: `python -m bench.tiles`.

Photos of 4000 x 3000 pixels of rendered solar parks, from several altitudes, with as many faults expected at each.
For each altitude and setting `tiles` there are recall and precision of mode `heavy` at confidence 0.25, of boxes that
overlap by one half. Then come processor times, in turns: from a photo's bytes to boxes, the network alone as often on
ready pictures, and the decoding. The bundled network is small: all else has a large share. See docs/detector.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from statistics import median

import cv2
import numpy as np
from bench.program import command_line, machine
from training.scoring import Judged, precision, recall

from upwash.services import Detector
from upwash.services.detector import Tiles
from upwash.services.solar_park import LABELS, RenderedPhoto, render_photo
from upwash.services.solar_park import photo as camera

WIDTH_PX, HEIGHT_PX = 4000, 3000
ALTITUDES_M = (10.0, 20.0, 40.0, 60.0, 80.0)
SETTINGS: Sequence[Tiles] = ("off", 1824, 1216, 912, "auto")
SEED = 9000  # none of the training
MOST_OVER_NETWORKS = 1.15


def main() -> None:
    """Prints both tables; a missed limit is printed as such and is no failure."""
    parser = command_line("tiles", __doc__)
    parser.add_argument("--photos", type=int, default=12, help="from each altitude (default: 12)")
    parser.add_argument("--rounds", type=int, default=20, help="of the times (default: 20)")
    parser.add_argument("--threads", type=int, help="of the network (default: all cores)")
    arguments = parser.parse_args()
    photos, rounds = (1, 1) if arguments.quick else (arguments.photos, arguments.rounds)
    settings = ("off", "auto") if arguments.quick else SETTINGS
    detectors = {tiles: Detector(tiles=tiles, threads=arguments.threads) for tiles in settings}
    print(f"photos of {WIDTH_PX} x {HEIGHT_PX} pixels; {machine()}")
    print("recall / precision\n| altitude | faults | " + " | ".join(map(str, detectors)) + " |")
    print("|---" * (2 + len(detectors)) + "|")
    for altitude_m in ALTITUDES_M[:1] if arguments.quick else ALTITUDES_M:
        taken = [large_photo(SEED + number, altitude_m) for number in range(photos)]
        scores = [scored(detector, taken) for detector in detectors.values()]
        faults = sum(len(photo.truth) for photo in taken)
        print(f"| {altitude_m:.0f} m | {faults} | " + " | ".join(scores) + " |", flush=True)
    jpeg = large_photo(SEED, 60.0).jpeg
    print("\n| tiles | runs | photo to boxes | networks alone | decoding | over networks | over both |")
    print("|---" * 7 + "|")
    for tiles, detector in detectors.items():
        print(f"| {tiles} | {race(detector, jpeg, rounds)} |", flush=True)


def large_photo(seed: int, altitude_m: float) -> RenderedPhoto:
    """A photo of a larger camera: each pixel has the noise of the usual camera's."""
    camera.WIDTH_PX, camera.HEIGHT_PX = WIDTH_PX, HEIGHT_PX
    camera._TARGET_BYTES, camera._CLOSE_BYTES = 3_300_000, 150_000
    return render_photo(seed, altitude_m=altitude_m)


def scored(detector: Detector, photos: Sequence[RenderedPhoto]) -> str:
    """Recall and precision of both labels together."""
    judged = [
        Judged(
            [box for box in found if box.label == label], [box for box in photo.truth if box.label == label]
        )
        for photo in photos
        for found in [detector.process_photo(photo.jpeg)]
        for label in LABELS
    ]
    return f"{recall(judged, confidence=0.25):.2f} / {precision(judged, confidence=0.25):.2f}"


def race(detector: Detector, jpeg: bytes, rounds: int) -> str:
    """The number of runs, and medians of the processor times and of their ratios."""
    heavy = detector._ways["heavy"]
    pictures, network = [picture for _, _, picture in heavy.looks(jpeg)], heavy.inference
    encoded = np.frombuffer(jpeg, np.uint8)
    how = cv2.IMREAD_COLOR if len(pictures) > 1 else cv2.IMREAD_REDUCED_COLOR_4
    ways: dict[str, Callable[[], object]] = {
        "whole": partial(detector.process_photo, jpeg),
        "networks": lambda: [network.run(picture) for picture in pictures],
        "decoding": partial(cv2.imdecode, encoded, how),
    }
    delays_s: dict[str, list[float]] = {way: [] for way in ways}
    for number in range(rounds + 1):
        for way, call in ways.items():
            began_s = time.process_time()
            call()
            if number:  # the first round warms up
                delays_s[way].append(time.process_time() - began_s)
    columns = " | ".join(f"{1000 * median(delays):.0f} ms" for delays in delays_s.values())
    turns = list(zip(*delays_s.values(), strict=True))
    over = median(whole / networks for whole, networks, _ in turns)
    over_both = median(whole / (networks + decoding) for whole, networks, decoding in turns)
    verdict = "" if len(pictures) == 1 else " PASS" if over_both <= MOST_OVER_NETWORKS else " MISS"
    return f"{len(pictures)} | {columns} | {over:.2f} | {over_both:.2f}{verdict}"


if __name__ == "__main__":
    main()
