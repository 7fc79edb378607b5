"""A Darknet network: its layers, each with its inputs from earlier layers.

Sizes are relative: a layer's `stride` says how many pixels of the input lie behind one cell of its output, at any
input size that the largest stride divides. A layer that would not keep to this is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

from upwash.errors import ModelError
from upwash.services.darknet.cfg import Section, read_sections
from upwash.support.text import counted

Activation = Literal["linear", "leaky", "relu", "logistic"]
Size = tuple[float, float]

_ACTIVATIONS = ("linear", "leaky", "relu", "logistic")
_MOST_STRIDE = 1024
_MOST_CHANNELS = 1_000_000  # of a layer; YOLOv3 has up to 1,024
# Options for training only, in Darknet and in its best known fork.
_TRAINING_OPTIONS = {
    "convolutional": frozenset({"learning_rate", "stopbackward", "dont_update", "burnin_update"}),
    "yolo": frozenset(
        {
            *("jitter", "random", "ignore_thresh", "truth_thresh", "max", "iou_thresh", "iou_loss"),
            *("iou_normalizer", "cls_normalizer", "obj_normalizer", "label_smooth_eps", "resize"),
        }
    ),
}


@dataclass(frozen=True, slots=True)
class Shape:
    """The output of a layer: its channels, and the input pixels behind one cell."""

    channels: int
    stride: int


@dataclass(frozen=True, slots=True)
class Convolutional:
    """A convolution, its batch norm if it has one, and its activation."""

    filters: int
    size: int
    stride: int
    padding: int  # on each side
    groups: int
    batch_normalize: bool
    activation: Activation


@dataclass(frozen=True, slots=True)
class MaxPool:
    """The maximum of each window; `padding` cells in all, the odd one at the end."""

    size: int
    stride: int
    padding: int


@dataclass(frozen=True, slots=True)
class Upsample:
    """Every cell repeated `factor` times in both directions."""

    factor: int


@dataclass(frozen=True, slots=True)
class Route:
    """The channels of earlier layers, one after the other."""

    sources: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Shortcut:
    """The sum of the layer before and an earlier one."""

    source: int
    activation: Activation


@dataclass(frozen=True, slots=True)
class Yolo:
    """A detection head on the layer before: anchor sizes are in pixels of the input."""

    anchors: tuple[Size, ...]
    classes: int


Operator = Convolutional | MaxPool | Upsample | Route | Shortcut | Yolo


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer, counted from 0 as Darknet does."""

    index: int
    where: str  # as errors name it
    operator: Operator
    input: Shape  # of the layer before
    output: Shape


@dataclass(frozen=True, slots=True)
class DarknetNetwork:
    """The layers of a cfg, which takes pictures of three channels."""

    layers: tuple[Layer, ...]

    @property
    def heads(self) -> tuple[Layer, ...]:
        """The detection heads."""
        return tuple(layer for layer in self.layers if isinstance(layer.operator, Yolo))


def read_network(file: Path, content: bytes) -> DarknetNetwork:
    """The network of a cfg's content; raises ModelError, with the layer, for what cannot be computed exactly."""
    sections = read_sections(file, content)
    if not sections or sections[0].name not in ("net", "network"):
        raise ModelError(file, "", "it does not begin with [net]: name a Darknet cfg")
    sections[0].integer("channels", 3, least=3, most=3)
    layers: list[Layer] = []
    for index, section in enumerate(sections[1:]):
        section.where = f"layer {index}, {section.where}"
        layers.append(_read_layer(section, layers))
    network = DarknetNetwork(tuple(layers))
    if not network.heads:
        raise ModelError(file, "", "it has no [yolo] layer, so it detects nothing: name a detector's cfg")
    if len({head.operator.classes for head in network.heads if isinstance(head.operator, Yolo)}) > 1:
        raise ModelError(file, "", "its [yolo] layers differ in classes: give all the same")
    return network


def _read_layer(section: Section, before: list[Layer]) -> Layer:
    if section.name not in _READERS:
        raise section.error(f"unknown layer type; supported are {', '.join(_READERS)}")
    previous = before[-1].output if before else Shape(3, 1)
    # Only the decoder reads a head; the next layer begins with a route.
    if before and isinstance(before[-1].operator, Yolo) and section.name != "route":
        raise section.error("it follows a [yolo] layer, which only a [route] can")
    operator, output = _READERS[section.name](section, previous, before)
    section.finish(ignored=_TRAINING_OPTIONS.get(section.name, frozenset()))
    return Layer(len(before), section.where, operator, previous, output)


def _convolutional(section: Section, previous: Shape, _: list[Layer]) -> tuple[Operator, Shape]:
    size = section.integer("size", 1, least=1, most=99)
    padding = section.integer("padding", 0, least=0, most=99)
    if section.integer("pad", 0, least=0, most=1):
        padding = size // 2
    convolution = Convolutional(
        filters=section.integer("filters", 1, least=1),
        size=size,
        stride=section.integer("stride", 1, least=1, most=99),
        padding=padding,
        groups=section.integer("groups", 1, least=1),
        batch_normalize=bool(section.integer("batch_normalize", 0, least=0, most=1)),
        activation=_activation(section, None),  # readers interpret a missing activation differently
    )
    if convolution.filters % convolution.groups or previous.channels % convolution.groups:
        raise section.error(
            f"groups={convolution.groups} divides not both its {counted(previous.channels, 'channel')} and its "
            f"{counted(convolution.filters, 'filter')}"
        )
    stride = _strided(section, previous, convolution.size, convolution.stride, 2 * padding)
    return convolution, Shape(convolution.filters, stride)


def _maxpool(section: Section, previous: Shape, _: list[Layer]) -> tuple[Operator, Shape]:
    stride = section.integer("stride", 1, least=1, most=99)
    size = section.integer("size", stride, least=1, most=99)
    padding = section.integer("padding", size - 1, least=0, most=99)
    pool = MaxPool(size, stride, padding)
    return pool, Shape(previous.channels, _strided(section, previous, size, stride, padding))


def _upsample(section: Section, previous: Shape, _: list[Layer]) -> tuple[Operator, Shape]:
    factor = section.integer("stride", 2, least=1, most=32)
    if previous.stride % factor:
        raise section.error(f"stride={factor}: its output would be finer than the input")
    return Upsample(factor), Shape(previous.channels, previous.stride // factor)


def _route(section: Section, _: Shape, before: list[Layer]) -> tuple[Operator, Shape]:
    sources = tuple(_source(section, "layers", number, before) for number in section.integers("layers"))
    shapes = [before[source].output for source in sources]
    if len({shape.stride for shape in shapes}) > 1:
        raise section.error(
            f"layers {', '.join(map(str, sources))} differ in size and cannot be put together"
        )
    channels = sum(shape.channels for shape in shapes)
    if channels > _MOST_CHANNELS:
        raise section.error(f"its output has {channels} channels: at most {_MOST_CHANNELS} can be computed")
    return Route(sources), Shape(channels, shapes[0].stride)


def _shortcut(section: Section, previous: Shape, before: list[Layer]) -> tuple[Operator, Shape]:
    (number, *more) = section.integers("from")
    if more:
        raise section.error("from names several layers: only one can be added")
    source = _source(section, "from", number, before)
    if before[source].output != previous:
        raise section.error(f"layers {source} and {len(before) - 1} differ in size and cannot be added")
    return Shortcut(source, _activation(section, "linear")), previous


def _yolo(section: Section, previous: Shape, _: list[Layer]) -> tuple[Operator, Shape]:
    anchors = section.sizes("anchors")
    if section.integer("num", len(anchors), least=1) != len(anchors):
        raise section.error(f"num does not fit its {counted(len(anchors), 'anchor')}")
    mask = section.integers("mask") if section.has("mask") else tuple(range(len(anchors)))
    if not all(0 <= number < len(anchors) for number in mask):
        raise section.error(f"mask names anchors other than 0 to {len(anchors) - 1}")
    head = Yolo(tuple(anchors[number] for number in mask), section.integer("classes", 20, least=1))
    needed = len(mask) * (5 + head.classes)
    if previous.channels != needed:
        raise section.error(
            f"the layer before has {counted(previous.channels, 'filter')}; {counted(len(mask), 'anchor')} and "
            f"{counted(head.classes, 'class')} need {needed}"
        )
    return head, previous


_READERS: dict[str, Callable[[Section, Shape, list[Layer]], tuple[Operator, Shape]]] = {
    "convolutional": _convolutional,
    "maxpool": _maxpool,
    "upsample": _upsample,
    "route": _route,
    "shortcut": _shortcut,
    "yolo": _yolo,
}


def _activation(section: Section, default: Activation | None) -> Activation:
    return cast(Activation, section.choice("activation", default, _ACTIVATIONS))


def _strided(section: Section, previous: Shape, size: int, stride: int, padding: int) -> int:
    """The stride of a layer whose output has one cell for each `stride` cells of any input."""
    if not padding < size <= padding + stride:
        raise section.error(
            f"size={size}, stride={stride} and {padding} cells of padding in all: its output would not be the "
            f"input's size divided by {stride}"
        )
    if previous.stride * stride > _MOST_STRIDE:
        raise section.error(f"its output would be more than {_MOST_STRIDE} times smaller than the input")
    return previous.stride * stride


def _source(section: Section, option: str, number: int, before: list[Layer]) -> int:
    index = len(before) + number if number < 0 else number
    if not 0 <= index < len(before):
        raise section.error(f"{option} names layer {number}: no earlier layer has this number")
    if isinstance(before[index].operator, Yolo):
        raise section.error(
            f"{option} names layer {index}, a [yolo] layer, whose output is not for other layers"
        )
    return index
