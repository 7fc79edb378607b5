"""What a batch gains: `python -m bench.batches`.

A network runs on several pictures at once, against one picture after the other, in turns. Below is what a batch
cannot share: from a photo's bytes to the network's picture. Times are of the processor, with one thread: threads that
wait for each other on a busy machine would flatter batches. See docs/decisions/batches.md.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

import cv2
import numpy as np
import onnx
import onnxruntime
from bench.detector import SIDES_PX, random_yolov3
from bench.program import command_line, machine
from numpy.typing import NDArray

from upwash.services import ModelFiles
from upwash.services.darknet.conversion import converted
from upwash.services.detector import SOLAR_PARK
from upwash.services.photo import read_photo
from upwash.services.solar_park import render_photo

SIZES = (2, 4, 8)
CELL_PX = 32
MEGAPIXELS = {"1.6": (1440, 1080), "12": (4000, 3000), "20": (5472, 3648)}


def main() -> None:
    """Measures and prints."""
    quick = command_line("batches", __doc__).parse_args().quick
    photo = render_photo(1).jpeg
    print(f"one thread; {machine()}; time of a batch over that of its pictures one at a time")
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory(prefix="upwash-bench-") as name:
        os.environ["XDG_CACHE_HOME"] = f"{name}/cache"
        for title, files, rounds in networks(Path(name), quick=quick):
            print(
                f"\n{title}, {rounds} rounds\n{'':8}{'alone':>10}" + "".join(f"{size:>8}" for size in SIZES)
            )
            session = session_of(files)
            for mode, side_px in SIDES_PX.items():
                picture, _ = read_photo(photo, side_px, CELL_PX)
                alone_s, ratios = compare(session, picture, rounds)
                print(f"{mode:8}{alone_s * 1e3:>7.1f} ms" + "".join(f"{ratio:>8.2f}" for ratio in ratios))
    print("\nfrom bytes to a picture of 608 pixels, for each photo")
    for title, (width, height) in MEGAPIXELS.items():
        print(
            f"{title:>4} megapixels {preparation_s(photo, width, height, 2 if quick else 15) * 1e3:>6.1f} ms"
        )


def networks(folder: Path, *, quick: bool) -> Iterator[tuple[str, ModelFiles, int]]:
    """Those that are measured; YOLOv3 takes a minute to make."""
    yield "bundled network", SOLAR_PARK, 1 if quick else 40
    if not quick:
        yield "YOLOv3, random weights", random_yolov3(folder), 3


def session_of(files: ModelFiles) -> onnxruntime.InferenceSession:
    """The network, for any number of pictures."""
    assert files.cfg is not None
    assert files.weights is not None
    with converted(files.cfg, files.weights) as file:
        model = onnx.load(file)
    for value in (*model.graph.input, *model.graph.output):
        value.type.tensor_type.shape.dim[0].dim_param = "pictures"
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )


def compare(
    session: onnxruntime.InferenceSession, picture: NDArray[np.float32], rounds: int
) -> tuple[float, list[float]]:
    """The time of one picture, and for each size of a batch the ratio; raises where the results differ."""
    name = session.get_inputs()[0].name
    pictures = np.concatenate([np.roll(picture, 8 * number, axis=3) for number in range(max(SIZES))])
    alone = [session.run(None, {name: pictures[[number]]}) for number in range(max(SIZES))]
    for index, output in enumerate(session.run(None, {name: pictures})):
        np.testing.assert_allclose(output, np.concatenate([one[index] for one in alone]), atol=1e-3)

    def run_s(size: int) -> float:
        return took_s(lambda: session.run(None, {name: pictures[:size]}))

    taken_s = [
        [median(run_s(1) for _ in range(min(SIZES) + 1)), *(run_s(size) for size in SIZES)]
        for _ in range(rounds)
    ]
    ratios = [median(row[1 + index] / (size * row[0]) for row in taken_s) for index, size in enumerate(SIZES)]
    return median(row[0] for row in taken_s), ratios


def preparation_s(photo: bytes, width: int, height: int, rounds: int) -> float:
    """The time from the bytes of a photo of that size to the network's picture."""
    pixels = cv2.imdecode(np.frombuffer(photo, np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    encoded = cv2.imencode(".jpg", cv2.resize(pixels, (width, height)))[1].tobytes()
    side_px = SIDES_PX["heavy"]
    return median(took_s(lambda: read_photo(encoded, side_px, CELL_PX)) for _ in range(rounds))


def took_s(do: Callable[[], object]) -> float:
    """How long the processor works on it."""
    began_s = time.process_time()
    do()
    return time.process_time() - began_s


if __name__ == "__main__":
    main()
