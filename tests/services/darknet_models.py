"""YOLOv3's networks as cfg files, written out from their published architecture, and random weights for any cfg.

J. Redmon, A. Farhadi, "YOLOv3: An Incremental Improvement", 2018; the SPP variant is Darknet's yolov3-spp. Also
forward passes by OpenCV's Darknet importer, an independent reader of the same files.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from upwash.services.darknet.layers import Convolutional, Shortcut, read_network

Floats = NDArray[np.float32]

ANCHORS = "10,13, 16,30, 33,23, 30,61, 62,45, 59,119, 116,90, 156,198, 373,326"
TINY_ANCHORS = "10,14, 23,27, 37,58, 81,82, 135,169, 344,319"
SPP_POOLS = (5, 9, 13)


def yolov3(*, spp: bool = False, divisor: int = 1) -> str:
    """The cfg of YOLOv3, or of its variant with spatial pyramid pooling; with a part of its filters, if wanted."""
    coarse, finer, finest = 512 // divisor, 256 // divisor, 128 // divisor
    parts = [
        NET,
        *_darknet53(divisor),
        *_head((6, 7, 8), coarse, pools=SPP_POOLS if spp else ()),
        *_finer(finer, 61),
        *_head((3, 4, 5), finer),
        *_finer(finest, 36),
        *_head((0, 1, 2), finest),
    ]
    return "".join(parts)


def small(*, classes: int = 2) -> str:
    """A network of every supported layer type, with heads at strides 16 and 8, that runs in a moment."""
    anchors = "12,12, 30,20, 60,60"
    parts = [NET, conv(8, 3, 2), pool(2, 2), conv(16, 3), conv(8, 1), conv(16, 3), SHORTCUT, pool(2, 2)]
    parts += [conv(32, 3), pool(2, 1), pool(2, 2), conv(32, 3), *_detect((1, 2), anchors, classes)]
    parts += [route(-3), conv(16, 1), UPSAMPLE, route(-1, 8), conv(16, 3), *_detect((0,), anchors, classes)]
    return "".join(parts)


def yolov3_tiny() -> str:
    """The cfg of YOLOv3-tiny."""
    parts = [NET]
    for filters in (16, 32, 64, 128, 256):
        parts += [conv(filters, 3), pool(2, 2)]
    parts += [
        conv(512, 3),
        pool(2, 1),
        conv(1024, 3),
        conv(256, 1),
        conv(512, 3),
        *_detect((3, 4, 5), TINY_ANCHORS),
    ]
    parts += [
        route(-4),
        conv(128, 1),
        UPSAMPLE,
        route(-1, 8),
        conv(256, 3),
        *_detect((0, 1, 2), TINY_ANCHORS),
    ]
    return "".join(parts)


NET = "[net]\nwidth=608\nheight=608\nchannels=3\nlearning_rate=0.001\n"
UPSAMPLE = "[upsample]\nstride=2\n"
SHORTCUT = "[shortcut]\nfrom=-3\nactivation=linear\n"


def conv(filters: int, size: int, stride: int = 1) -> str:
    """A convolution as nearly all are: with batch norm, leaky, as large as its input divided by its stride."""
    return (
        f"[convolutional]\nbatch_normalize=1\nfilters={filters}\nsize={size}\nstride={stride}\npad=1\n"
        "activation=leaky\n"
    )


def pool(size: int, stride: int) -> str:
    """A maximum over windows."""
    return f"[maxpool]\nsize={size}\nstride={stride}\n"


def route(*layers: int) -> str:
    """Earlier layers put together."""
    return f"[route]\nlayers={', '.join(map(str, layers))}\n"


def yolo(mask: tuple[int, ...], anchors: str, classes: int) -> str:
    """A head, with the options that training leaves in it."""
    return (
        f"[yolo]\nmask = {','.join(map(str, mask))}\nanchors = {anchors}\nclasses={classes}\n"
        f"num={len(anchors.split(',')) // 2}\njitter=.3\nignore_thresh = .7\ntruth_thresh = 1\nrandom=1\n"
    )


def _darknet53(divisor: int) -> Iterator[str]:
    yield conv(32 // divisor, 3)
    for all_filters, residuals in ((64, 1), (128, 2), (256, 8), (512, 8), (1024, 4)):
        filters = all_filters // divisor
        yield conv(filters, 3, 2)
        for _ in range(residuals):
            yield from (conv(filters // 2, 1), conv(filters, 3), SHORTCUT)


def write_model(folder: Path, cfg: str, *, seed: int = 1) -> tuple[Path, Path]:
    """The cfg and random weights for it as files; the numbers keep a picture's spread from layer to layer."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = folder / "model.cfg", folder / "model.weights"
    paths[0].write_text(cfg)
    rng = np.random.default_rng(seed)
    with paths[1].open("wb") as file:
        file.write(np.array([0, 2, 5], "<i4").tobytes() + np.array([0], "<i8").tobytes())
        layers = read_network(paths[0], cfg.encode()).layers
        for layer, after in itertools.zip_longest(layers, layers[1:]):
            if isinstance(layer.operator, Convolutional):
                # A residual's sum would otherwise double the spread at each of its 23 additions.
                gain = 0.3 if after is not None and isinstance(after.operator, Shortcut) else 1.5
                for numbers in _random(layer.operator, layer.input.channels, rng, gain):
                    file.write(numbers.astype("<f4").tobytes())
    return paths


def _random(
    convolution: Convolutional, channels: int, rng: np.random.Generator, gain: float
) -> Iterator[Floats]:
    """Biases, then for a batch norm scales, means and variances, then weights, as the file has them."""
    filters = convolution.filters
    inputs = channels // convolution.groups * convolution.size**2
    yield rng.normal(0, 0.1, filters).astype(np.float32)
    if convolution.batch_normalize:
        yield rng.uniform(0.8, 1.2, filters).astype(np.float32)
        yield rng.normal(0, 0.1, filters).astype(np.float32)
        yield rng.uniform(0.5, 1.5, filters).astype(np.float32)
    weights = rng.random(filters * inputs, np.float32) - np.float32(0.5)
    yield weights * np.float32((12 * gain / inputs) ** 0.5)


def weights_for_opencv(cfg: Path, weights: Path, folder: Path) -> Path:
    """The weights with variances for which OpenCV's sqrt(variance + 1e-6) is Darknet's sqrt(variance) + 1e-6.

    The two differ for the small variances of a trained network.
    """
    content = weights.read_bytes()
    numbers = np.frombuffer(content, "<f4", offset=20).copy()
    at = 0
    for layer in read_network(cfg, cfg.read_bytes()).layers:
        if not isinstance(layer.operator, Convolutional):
            continue
        convolution = layer.operator
        filters = convolution.filters
        if convolution.batch_normalize:
            variances = numbers[at + 3 * filters : at + 4 * filters]
            variances[:] = (np.sqrt(variances.astype(float)) + 1e-6) ** 2 - 1e-6
        vectors = 4 if convolution.batch_normalize else 1
        at += vectors * filters
        at += filters * (layer.input.channels // convolution.groups) * convolution.size**2
    assert at == len(numbers)
    file = folder / "for_opencv.weights"
    file.write_bytes(content[:20] + numbers.tobytes())
    return file


def write_labels(folder: Path, count: int) -> Path:
    """A file of that many names."""
    file = folder / "model.names"
    file.write_text("".join(f"thing {number}\n" for number in range(count)))
    return file


def opencv_heads(cfg: Path, weights: Path, picture: Floats) -> list[Floats]:
    """What OpenCV's importer says that the heads' convolutions put out."""
    return _opencv(cfg, weights, picture, lambda index: f"conv_{index - 1}")


def opencv_boxes(cfg: Path, weights: Path, picture: Floats) -> list[Floats]:
    """What it makes of each head: rows of centre, width and height as shares of the picture, objectness, scores."""
    return _opencv(cfg, weights, picture, lambda index: f"yolo_{index}")


def _opencv(cfg: Path, weights: Path, picture: Floats, name: Callable[[int], str]) -> list[Floats]:
    net = cv2.dnn.readNetFromDarknet(str(cfg), str(weights))
    net.setInput(picture)
    heads: list[Any] = list(
        net.forward([name(layer.index) for layer in read_network(cfg, cfg.read_bytes()).heads])
    )
    return heads


def _head(mask: tuple[int, ...], filters: int, *, pools: tuple[int, ...] = ()) -> Iterator[str]:
    yield from (conv(filters, 1), conv(2 * filters, 3), conv(filters, 1))
    for number, size in enumerate(pools):
        if number:
            yield route(-2 * number)
        yield pool(size, 1)
    if pools:
        yield from (route(-1, -3, -5, -6), conv(filters, 1))
    yield from (conv(2 * filters, 3), conv(filters, 1), conv(2 * filters, 3))
    yield from _detect(mask, ANCHORS)


def _detect(mask: tuple[int, ...], anchors: str, classes: int = 80) -> Iterator[str]:
    filters = len(mask) * (5 + classes)
    yield f"[convolutional]\nsize=1\nstride=1\npad=1\nfilters={filters}\nactivation=linear\n"
    yield yolo(mask, anchors, classes)


def _finer(filters: int, layer: int) -> Iterator[str]:
    yield from (route(-4), conv(filters, 1), UPSAMPLE, route(-1, layer))
