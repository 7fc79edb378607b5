"""The detector: its own network or the user's, on photos of any size."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import Meta

from upwash.rpc.service import service
from upwash.services.detection import Box, Detection, Mode
from upwash.services.heads import by
from upwash.services.inference import Engine, Inference, ModelFiles, open_inference
from upwash.services.photo import Letterbox, NotAPhoto, decode_photo, photo_size, read_photo, whole_size
from upwash.services.provider import Provider
from upwash.services.shrink import Shrink
from upwash.services.tiles import MOST_TILES, TileBox, View, merged, tiles_of
from upwash.support.loading import extra

if TYPE_CHECKING:
    from upwash.services.inference import Floats

Threads = Annotated[int, Meta(ge=1, le=1024, description="an integer from 1 to 1024")]
LEAST_SIDE_PX, MOST_SIDE_PX = 32, 4096
Side = Annotated[
    int, Meta(ge=LEAST_SIDE_PX, le=MOST_SIDE_PX, description="an integer from 32 to 4096, in pixels")
]
Tiles = Annotated[
    Annotated[int, Meta(ge=LEAST_SIDE_PX, le=MOST_SIDE_PX)] | Literal["off", "auto"],
    Meta(description='"off", "auto" or an integer from 32 to 4096, in pixels'),
]
Megapixels = Annotated[int, Meta(ge=1, le=1000, description="an integer from 1 to 1000, in megapixels")]

_LARGE = 1.5  # times a tile of "auto"; a smaller photo loses little in one picture
_MODELS = Path(__file__).with_name("models")
SOLAR_PARK = ModelFiles(
    names=_MODELS / "solar_park.names",
    cfg=_MODELS / "solar_park.cfg",
    weights=_MODELS / "solar_park.weights",
)


@service(profile_by="mode", before_sending=Shrink)
class Detector:
    """Detects objects: in mode `light` on pictures of 320 pixels, in mode `heavy` of 608, which show smaller objects.

    A network that takes pictures of one size has these in both modes, and `light_model` is another network for mode
    `light`. With `tiles`, mode `heavy` looks at large photos in overlapping tiles too, of the picture's size ("auto")
    or of that many of the photo's pixels. `threads` defaults to all cores that the process may use. Raises ModelError
    for unusable model files, and UsageError for missing packages.
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
        tiles: Tiles = "off",
        max_photo_mpixels: Megapixels | None = None,
    ) -> None:
        _require_packages(engine)
        threads = threads or _cores()
        heavy = open_inference(model, threads=threads, provider=provider, engine=engine)
        light = heavy
        if light_model is not None:
            light = open_inference(light_model, threads=threads, provider=provider, engine=engine)
        light_px = light_px or _fitting(light, 320)
        heavy_px = heavy_px or _fitting(heavy, 608)
        most_pixels = 1_000_000 * max_photo_mpixels if max_photo_mpixels else None
        way = _Way.of(light, light_px, most_pixels)
        same = heavy is light and heavy_px == light_px
        heavy_way = way if same else _Way.of(heavy, heavy_px, most_pixels)
        self._ways: dict[Mode, _Way] = {"light": way, "heavy": heavy_way.in_tiles(tiles)}
        for mode, way in self._ways.items():
            if described := way.inference.describe():
                _tell(f"{mode}: {described}, {by(way.frame_px)}")
            if way.tile_px is not None:
                _tell(f"{mode}: photos beyond {by(way.whole_px)} in tiles of {by(way.tile_px)}")
        for network in dict.fromkeys((light, heavy)):
            if network.tested is not None and network.describe():
                _tell(f"{network.name}: {network.tested.found}")
            for doubt in network.doubts():
                _tell(f"warning: {network.name}: {doubt}")

    def process_photo(self, photo: bytes, mode: Mode = "heavy", confidence: float = 0.25) -> list[Detection]:
        """The objects above `confidence` in a photo, best first; raises NotAPhoto."""
        if not 0 <= confidence <= 1:
            raise ValueError(f"confidence = {confidence}: give a number from 0 to 1")
        way = self._ways[mode]
        sightings: Iterable[TileBox] = way.sightings(photo, confidence)
        if way.tile_px is not None:
            sightings = merged(sightings, View(0, 0, *photo_size(photo, way.most_pixels)))
        across = down = 1.0
        if (whole_px := whole_size(photo)) is not None:
            width_px, height_px = photo_size(photo, way.most_pixels)
            across, down = whole_px[0] / width_px, whole_px[1] / height_px
        return [
            Detection(
                left_px=across * box.left_px,
                top_px=down * box.top_px,
                width_px=across * box.width_px,
                height_px=down * box.height_px,
                label=way.inference.label(index),
                score=score,
            )
            for _, box, score, index in sightings
        ]


@dataclass(frozen=True, slots=True)
class _Way:
    """How a mode looks at photos."""

    inference: Inference
    side_px: int
    cell_px: int | None
    most_pixels: int | None
    tile_px: tuple[int, int] | None = None  # width and height
    whole_px: tuple[int, int] = (0, 0)  # no tiles of photos within it

    @classmethod
    def of(cls, inference: Inference, side_px: int, most_pixels: int | None) -> _Way:
        inference.require_side(side_px)
        return cls(inference, side_px, inference.cell_px(side_px), most_pixels)

    @property
    def frame_px(self) -> tuple[int, int]:
        """The width and height of the largest picture."""
        height_px, width_px = self.inference.frame_px or (self.side_px, self.side_px)
        return width_px, height_px

    def in_tiles(self, tiles: Tiles) -> _Way:
        """The same, of large photos in tiles."""
        if tiles == "off":
            return self
        width_px, height_px = self.frame_px
        if tiles == "auto":
            whole_px = (int(_LARGE * width_px), int(_LARGE * height_px))
            return replace(self, tile_px=self.frame_px, whole_px=whole_px)
        scale = tiles / max(self.frame_px)
        tile_px = (max(1, round(width_px * scale)), max(1, round(height_px * scale)))
        return replace(self, tile_px=tile_px, whole_px=tile_px)

    def sightings(self, photo: bytes, confidence: float) -> Iterator[TileBox]:
        """Boxes of the whole photo, and then of its tiles if it is large; raises NotAPhoto."""
        for view, letterbox, picture in self.looks(photo):
            seen = self.inference.find(picture, confidence=confidence)
            for corners, score, index in zip(seen.boxes, seen.scores, seen.classes, strict=True):
                if (box := letterbox.on_photo(corners)) is not None:
                    left_px, top_px = view.left_px + box.left_px, view.top_px + box.top_px
                    box = Box(left_px, top_px, box.width_px, box.height_px)
                    yield TileBox(view, box, float(score), int(index))

    def looks(self, photo: bytes) -> Iterator[tuple[View, Letterbox, Floats]]:
        """Pictures of the whole photo and of its tiles, and what they show."""
        network = self.inference
        tiles = self._tiles(photo)
        if not tiles:
            picture, letterbox = read_photo(
                photo,
                self.side_px,
                self.cell_px,
                grey=network.grey,
                stretched=network.stretched,
                frame_px=network.frame_px,
                most_pixels=self.most_pixels,
            )
            yield View(0, 0, letterbox.photo_width_px, letterbox.photo_height_px), letterbox, picture
            return
        pixels = decode_photo(photo, self.most_pixels)
        height_px, width_px = pixels.shape[:2]
        for view in (View(0, 0, width_px, height_px), *tiles):
            letterbox = Letterbox(
                view.right_px - view.left_px,
                view.bottom_px - view.top_px,
                self.side_px,
                self.cell_px,
                network.grey,
                network.stretched,
                network.frame_px,
            )
            shown = pixels[view.top_px : view.bottom_px, view.left_px : view.right_px]
            yield view, letterbox, letterbox.picture(shown)

    def _tiles(self, photo: bytes) -> list[View]:
        if self.tile_px is None:
            return []
        width_px, height_px = photo_size(photo, self.most_pixels)
        if width_px <= self.whole_px[0] and height_px <= self.whole_px[1]:
            return []
        tiles = tiles_of(width_px, height_px, self.tile_px)
        if len(tiles) > MOST_TILES:
            raise NotAPhoto(
                f"the photo of {width_px} x {height_px} pixels has {len(tiles)} tiles of {by(self.tile_px)}, and at "
                f"most {MOST_TILES} are looked at: set the detector's tiles to more pixels"
            )
        return tiles


def _tell(what: str) -> None:
    """For who starts it; the log of a server has what instances print."""
    print(what, file=sys.stderr, flush=True)  # noqa: T201


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
