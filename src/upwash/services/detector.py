"""The detector: its own network or the user's, on photos of any size."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from msgspec import Meta
from msgspec.structs import asdict

from upwash.rpc.service import service
from upwash.services.detection import Detection, Mode
from upwash.services.inference import Engine, Inference, ModelFiles, open_inference
from upwash.services.photo import read_photo
from upwash.services.provider import Provider
from upwash.support.loading import extra

Threads = Annotated[int, Meta(ge=1, le=1024, description="an integer from 1 to 1024")]
LEAST_SIDE_PX, MOST_SIDE_PX = 32, 4096
Side = Annotated[
    int, Meta(ge=LEAST_SIDE_PX, le=MOST_SIDE_PX, description="an integer from 32 to 4096, in pixels")
]

_MODELS = Path(__file__).with_name("models")
SOLAR_PARK = ModelFiles(
    names=_MODELS / "solar_park.names",
    cfg=_MODELS / "solar_park.cfg",
    weights=_MODELS / "solar_park.weights",
)


@service(profile_by="mode")
class Detector:
    """Detects objects: in mode `light` on pictures of 320 pixels, in mode `heavy` of 608, which show smaller objects.

    A network that takes pictures of one size has these in both modes, and `light_model` is another network for mode
    `light`. `threads` defaults to all cores that the process may use. Raises ModelError for unusable model files, and
    UsageError for missing packages.
    """

    def __init__(
        self,
        *,
        model: ModelFiles = SOLAR_PARK,
        light_model: ModelFiles | None = None,
        threads: Threads | None = None,
        provider: Provider = "auto",
        engine: Engine = "onnxruntime",
        light_px: Side | None = None,
        heavy_px: Side | None = None,
    ) -> None:
        _require_packages(engine)
        threads = threads or _cores()
        heavy = open_inference(model, threads=threads, provider=provider, engine=engine)
        light = heavy
        if light_model is not None:
            light = open_inference(light_model, threads=threads, provider=provider, engine=engine)
        light_px = light_px or _fitting(light, 320)
        heavy_px = heavy_px or _fitting(heavy, 608)
        way = _Way.of(light, light_px)
        same = heavy is light and heavy_px == light_px
        self._ways: dict[Mode, _Way] = {"light": way, "heavy": way if same else _Way.of(heavy, heavy_px)}
        for mode, way in self._ways.items():
            if described := way.inference.describe():
                height_px, width_px = way.inference.frame_px or (way.side_px, way.side_px)
                # For who starts it; the log of a server has what instances print.
                print(f"{mode}: {described}, {width_px} x {height_px}", file=sys.stderr, flush=True)  # noqa: T201

    def process_photo(self, photo: bytes, mode: Mode = "heavy", confidence: float = 0.25) -> list[Detection]:
        """The objects above `confidence` in a photo, best first; raises NotAPhoto."""
        if not 0 <= confidence <= 1:
            raise ValueError(f"confidence = {confidence}: give a number from 0 to 1")
        way = self._ways[mode]
        network = way.inference
        picture, letterbox = read_photo(
            photo,
            way.side_px,
            way.cell_px,
            grey=network.grey,
            stretched=network.stretched,
            frame_px=network.frame_px,
        )
        found = network.find(picture, confidence=confidence)
        return [
            Detection(**asdict(box), label=network.label(index), score=float(score))
            for corners, score, index in zip(found.boxes, found.scores, found.classes, strict=True)
            if (box := letterbox.on_photo(corners)) is not None
        ]


@dataclass(frozen=True, slots=True)
class _Way:
    """How a mode looks at photos."""

    inference: Inference
    side_px: int
    cell_px: int | None

    @classmethod
    def of(cls, inference: Inference, side_px: int) -> _Way:
        inference.require_side(side_px)
        return cls(inference, side_px, inference.cell_px(side_px))


def _fitting(inference: Inference, side_px: int) -> int:
    only_px = inference.frame_px or (side_px,)
    return max(only_px) if min(only_px) >= LEAST_SIDE_PX and max(only_px) <= MOST_SIDE_PX else side_px


def _cores() -> int:
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _require_packages(engine: Engine) -> None:
    needed: dict[str, tuple[str, ...]] = {"detector": ("cv2", "numpy", "onnx", "onnxruntime")}
    if engine == "ncnn":
        needed["ncnn"] = ("ncnn",)
    for name, packages in needed.items():
        with extra(name):
            for package in packages:  # found, not imported: not every model needs each
                if find_spec(package) is None:
                    raise ModuleNotFoundError(f"No module named {package!r}", name=package)
