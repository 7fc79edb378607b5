"""A Darknet network in the format of ncnn: a text of layers, and the numbers of the convolutions in order.

ncnn's documents call the two files param and bin. A blob has one reader, so a
split layer copies a blob that several layers read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from upwash.services.darknet.graph import INPUT, LEAKY_SLOPE, input_of, output_of
from upwash.services.darknet.layers import (
    Activation,
    Convolutional,
    DarknetNetwork,
    Layer,
    MaxPool,
    Route,
    Shortcut,
    Upsample,
    Yolo,
)

_MAGIC = 7767517
PLAIN_FLOATS = b"\0\0\0\0"  # precedes the weights of each convolution
_ACTIVATIONS = {"linear": "", "leaky": f"9=2 -23310=1,{LEAKY_SLOPE}", "relu": "9=1", "logistic": "9=4"}
_ACTIVATION_LAYERS = {"leaky": ("ReLU", f"0={LEAKY_SLOPE}"), "relu": ("ReLU",), "logistic": ("Sigmoid",)}


def describe(network: DarknetNetwork) -> str:
    """The text of layers."""
    lines: list[str] = []
    blobs = 0
    for kind, inputs, outputs, options in _with_splits(list(_layers(network))):
        counts = f"{len(inputs)} {len(outputs)}"
        lines.append(" ".join([kind, f"{kind}-{len(lines)}", counts, *inputs, *outputs, *options]))
        blobs += len(outputs)
    return "\n".join([str(_MAGIC), f"{len(lines)} {blobs}", *lines, ""])


_Entry = tuple[str, list[str], list[str], list[str]]  # kind, inputs, outputs, options


def _layers(network: DarknetNetwork) -> Iterator[_Entry]:
    yield "Input", [], [INPUT], []
    for layer in network.layers:
        before, output = input_of(layer, network), [output_of(layer)]
        match layer.operator:
            case Convolutional() as convolution:
                kind = "Convolution" if convolution.groups == 1 else "ConvolutionDepthWise"
                yield kind, [before], output, _convolution(layer, convolution)
            case MaxPool(size, stride, padding):
                first, last = padding // 2, padding - padding // 2
                sides = [f"3={first}", f"13={first}", f"14={last}", f"15={last}"]
                yield "Pooling", [before], output, ["0=0", f"1={size}", f"2={stride}", *sides, "5=1"]
            case Upsample(factor):
                yield "Interp", [before], output, ["0=1", f"1={factor}.0", f"2={factor}.0"]
            case Route(sources):
                inputs = [output_of(network.layers[source]) for source in sources]
                yield "Concat", inputs, output, ["0=0"]
            case Shortcut(source, activation):
                inputs = [before, output_of(network.layers[source])]
                yield from _sum(inputs, output, activation)
            case Yolo():
                yield "Noop", [before], output, []


def _convolution(layer: Layer, convolution: Convolutional) -> list[str]:
    weights = convolution.filters * layer.input.channels // convolution.groups * convolution.size**2
    numbers = {
        0: convolution.filters,
        1: convolution.size,
        3: convolution.stride,
        4: convolution.padding,
        5: 1,
        6: weights,
    }
    if convolution.groups > 1:
        numbers[7] = convolution.groups
    options = [f"{key}={number}" for key, number in numbers.items()]
    return options + _ACTIVATIONS[convolution.activation].split()


def _sum(inputs: list[str], output: list[str], activation: Activation) -> Iterator[_Entry]:
    linear = output if activation == "linear" else [f"{output[0]}-linear"]
    yield "BinaryOp", inputs, linear, ["0=0"]
    if activation != "linear":
        kind, *options = _ACTIVATION_LAYERS[activation]
        yield kind, linear, output, options


def _with_splits(entries: list[_Entry]) -> Iterator[_Entry]:
    """The entries, with a Split layer after each output that several layers read."""
    readers = Counter(name for _, inputs, *_ in entries for name in inputs)
    given: Counter[str] = Counter()

    def one_of(name: str) -> str:
        if readers[name] < 2:
            return name
        given[name] += 1
        return f"{name}-{given[name]}"

    for kind, inputs, outputs, options in entries:
        yield kind, [one_of(name) for name in inputs], outputs, options
        for name in outputs:
            if readers[name] > 1:
                yield "Split", [name], [f"{name}-{number}" for number in range(1, readers[name] + 1)], []
