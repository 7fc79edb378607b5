"""The detector: a YOLOv3 network, its own or the user's, on photos of any size."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from msgspec import Meta
from msgspec.structs import asdict

from upwash.rpc.service import service
from upwash.services.darknet.heads import best_of_each, read_heads
from upwash.services.detection import Detection, Mode
from upwash.services.inference import Engine, ModelFiles, open_inference
from upwash.services.photo import read_photo
from upwash.services.provider import Provider
from upwash.support.loading import extra

Threads = Annotated[int, Meta(ge=1, le=1024, description="an integer from 1 to 1024")]
Side = Annotated[int, Meta(ge=32, le=4096, description="an integer from 32 to 4096, in pixels")]

_MODELS = Path(__file__).with_name("models")
SOLAR_PARK = ModelFiles(
    names=_MODELS / "solar_park.names",
    cfg=_MODELS / "solar_park.cfg",
    weights=_MODELS / "solar_park.weights",
)


@service(profile_by="mode")
class Detector:
    """Detects objects: in mode `light` on pictures of 320 pixels, in mode `heavy` of 608, which show smaller objects.

    `threads` defaults to all cores that the process may use. Raises ModelError for unusable model files, and
    UsageError for missing packages.
    """

    def __init__(
        self,
        *,
        model: ModelFiles = SOLAR_PARK,
        threads: Threads | None = None,
        provider: Provider = "cpu",
        engine: Engine = "onnxruntime",
        light_px: Side = 320,
        heavy_px: Side = 608,
    ) -> None:
        _require_packages(engine)
        self._inference = open_inference(model, threads=threads or _cores(), provider=provider, engine=engine)
        self._sides_px: dict[Mode, int] = {"light": light_px, "heavy": heavy_px}
        for side_px in self._sides_px.values():
            self._inference.require_side(side_px)
        self._cells_px = {mode: self._inference.cell_px(side_px) for mode, side_px in self._sides_px.items()}

    def process_photo(self, photo: bytes, mode: Mode = "heavy", confidence: float = 0.25) -> list[Detection]:
        """The objects above `confidence` in a JPEG of at most 40 megapixels, best first; raises NotAPhoto."""
        if not 0 <= confidence <= 1:
            raise ValueError(f"confidence = {confidence}: give a number from 0 to 1")
        picture, letterbox = read_photo(photo, self._sides_px[mode], self._cells_px[mode])
        outputs = self._inference.run(picture)
        found = best_of_each(read_heads(outputs, self._inference.heads, confidence=confidence))
        return [
            Detection(**asdict(box), label=self._inference.labels[index], score=float(score))
            for corners, score, index in zip(found.boxes, found.scores, found.classes, strict=True)
            if (box := letterbox.on_photo(corners)) is not None
        ]


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
