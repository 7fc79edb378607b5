"""A Darknet network in torch, built from its cfg, and its weights in Darknet's file format."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

Section = tuple[str, dict[str, str]]

_DARKNET_EPSILON = 1e-6  # added to the standard deviation, where torch adds its own to the variance
_VERSION = (0, 2, 5)  # of the file format: the first whose count of seen photos has 64 bits


@dataclass(frozen=True, slots=True)
class Head:
    """What one `yolo` layer gets: by photo, anchor, row and column the numbers x, y, w, h, object and classes."""

    raw: Tensor
    anchors_px: Tensor
    stride_px: int


class Network(nn.Module):
    """The layers of a cfg file; calling it returns its heads."""

    def __init__(self, cfg: Path) -> None:
        super().__init__()
        net, *sections = _sections(cfg)
        self._sections = sections
        self.layers = nn.ModuleList()
        channels = [int(net[1]["channels"])]
        for kind, options in sections:
            layer, out = _layer(kind, options, channels)
            self.layers.append(layer)
            channels.append(out)

    def forward(self, photos: Tensor) -> list[Head]:
        """The heads for a batch of RGB photos, 0 to 1."""
        outputs: list[Tensor] = []
        heads = []
        now = photos
        for (kind, options), layer in zip(self._sections, self.layers, strict=True):
            match kind:
                case "shortcut":
                    now = now + outputs[_absolute(int(options["from"]), len(outputs))]
                case "route":
                    sources = [_absolute(int(each), len(outputs)) for each in options["layers"].split(",")]
                    now = torch.cat([outputs[source] for source in sources], dim=1)
                case "yolo":
                    heads.append(_head(now, options, stride_px=photos.shape[-1] // now.shape[-1]))
                case _:
                    now = layer(now)
            outputs.append(now)
        return heads

    def write_weights(self, file: Path, *, seen: int) -> None:
        """Writes Darknet's weights file; `seen` counts the photos that it learned from."""
        with file.open("wb") as out:
            out.write(np.array(_VERSION, np.int32).tobytes())
            out.write(np.array([seen], np.int64).tobytes())
            for layer in self.layers:
                if isinstance(layer, _Convolutional):
                    for numbers in layer.darknet_numbers():
                        out.write(numbers.detach().float().cpu().numpy().tobytes())


class _Convolutional(nn.Module):
    def __init__(self, options: dict[str, str], channels: int) -> None:
        super().__init__()
        size, filters = int(options["size"]), int(options["filters"])
        self.normalized = options.get("batch_normalize") == "1"
        self.convolution = nn.Conv2d(
            channels, filters, size, int(options["stride"]), padding=size // 2, bias=not self.normalized
        )
        self.norm = nn.BatchNorm2d(filters) if self.normalized else None
        self.leaky = options["activation"] == "leaky"

    def forward(self, now: Tensor) -> Tensor:
        now = self.convolution(now)
        if self.norm is not None:
            now = self.norm(now)
        return functional.leaky_relu(now, 0.1) if self.leaky else now

    def darknet_numbers(self) -> Iterator[Tensor]:
        norm = self.norm
        if norm is None:
            assert self.convolution.bias is not None
            yield self.convolution.bias
        else:
            assert norm.running_mean is not None and norm.running_var is not None
            deviation = (norm.running_var.double() + norm.eps).sqrt()
            yield from (norm.bias, norm.weight, norm.running_mean)
            yield (deviation - _DARKNET_EPSILON).square()
        yield self.convolution.weight


def _sections(cfg: Path) -> list[Section]:
    sections: list[Section] = []
    for line in cfg.read_text().splitlines():
        text = line.partition("#")[0].strip()
        if text.startswith("["):
            sections.append((text.strip("[]"), {}))
        elif text:
            key, _, value = text.partition("=")
            sections[-1][1][key.strip()] = value.strip()
    return sections


def _layer(kind: str, options: dict[str, str], channels: list[int]) -> tuple[nn.Module, int]:
    """The layer and its number of channels; `channels` has the input's and those of every layer before."""
    match kind:
        case "convolutional":
            return _Convolutional(options, channels[-1]), int(options["filters"])
        case "upsample":
            return nn.Upsample(scale_factor=int(options["stride"])), channels[-1]
        case "route":
            sources = (_absolute(int(each), len(channels) - 1) for each in options["layers"].split(","))
            return nn.Identity(), sum(channels[source + 1] for source in sources)
        case "shortcut" | "yolo":
            return nn.Identity(), channels[-1]
    raise ValueError(f"the training program knows no layer [{kind}]")


def _absolute(layer: int, here: int) -> int:
    return layer if layer >= 0 else here + layer


def _head(now: Tensor, options: dict[str, str], *, stride_px: int) -> Head:
    numbers = [float(number) for number in options["anchors"].split(",")]
    mask = [int(index) for index in options["mask"].split(",")]
    anchors = torch.tensor(numbers).view(-1, 2)[mask]
    count, _, rows, columns = now.shape
    raw = now.float().view(count, len(mask), -1, rows, columns).permute(0, 1, 3, 4, 2)
    return Head(raw, anchors, stride_px)
