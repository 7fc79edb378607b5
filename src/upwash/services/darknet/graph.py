"""A Darknet network as an ONNX model with raw heads: its outputs are those of the last convolutions.

The model refers to its numbers in a file of their own, where they stand in the order of the layers, for each
convolution its weights and then its biases: onnxruntime maps that file instead of reading it into memory twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from upwash.services.darknet.heads import HEADS_METADATA, Head, encode_heads
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

if TYPE_CHECKING:
    import onnx

_OPSET = 13
_IR_VERSION = 8
_FLOAT_BYTES = 4
LEAKY_SLOPE = 0.1
INPUT = "picture"  # 1, 3, height, width: red, green, blue from 0 to 1
_ACTIVATION_NODES = {"leaky": "LeakyRelu", "relu": "Relu", "logistic": "Sigmoid"}


def build_model(network: DarknetNetwork, numbers: str) -> onnx.ModelProto:
    """The model, for any input size that its largest stride divides; `numbers` names the file beside it."""
    import onnx
    from onnx import TensorProto, helper

    graph = onnx.GraphProto(name="darknet")
    graph.input.append(helper.make_tensor_value_info(INPUT, TensorProto.FLOAT, [1, 3, "height", "width"]))
    for layer in network.layers:
        graph.node.extend(_nodes(layer, network))
        if isinstance(layer.operator, Upsample):
            factor = float(layer.operator.factor)
            scales = helper.make_tensor(
                f"scales{layer.index}", TensorProto.FLOAT, [4], [1.0, 1.0, factor, factor]
            )
            graph.initializer.append(scales)
    graph.initializer.extend(_parameters(network, numbers))
    for layer in network.heads:
        shape = [1, layer.output.channels, None, None]
        graph.output.append(helper.make_tensor_value_info(output_of(layer), TensorProto.FLOAT, shape))
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR_VERSION)
    helper.set_model_props(model, {HEADS_METADATA: encode_heads(heads_of(network))})
    return model


def _parameters(network: DarknetNetwork, numbers: str) -> Iterator[onnx.TensorProto]:
    from onnx import StringStringEntryProto, TensorProto

    offset = 0
    for layer in network.layers:
        if not isinstance(layer.operator, Convolutional):
            continue
        convolution = layer.operator
        shape = (convolution.filters, layer.input.channels // convolution.groups, *[convolution.size] * 2)
        for name, dimensions in (("weights", shape), ("biases", shape[:1])):
            length = _FLOAT_BYTES * math.prod(dimensions)
            place = {"location": numbers, "offset": str(offset), "length": str(length)}
            yield TensorProto(
                name=f"{name}{layer.index}",
                data_type=TensorProto.FLOAT,
                dims=dimensions,
                data_location=TensorProto.EXTERNAL,
                external_data=[StringStringEntryProto(key=key, value=value) for key, value in place.items()],
            )
            offset += length


def heads_of(network: DarknetNetwork) -> Iterator[Head]:
    """The heads of a network."""
    for layer in network.heads:
        assert isinstance(layer.operator, Yolo)  # noqa: S101 - heads are Yolo layers
        yield Head(output=output_of(layer), stride=layer.output.stride, anchors=layer.operator.anchors)


def _nodes(layer: Layer, network: DarknetNetwork) -> Iterator[onnx.NodeProto]:
    from onnx import helper

    before, output = input_of(layer, network), output_of(layer)
    match layer.operator:
        case Convolutional() as convolution:
            yield from _activated(
                "Conv",
                [before, f"weights{layer.index}", f"biases{layer.index}"],
                output,
                convolution.activation,
                kernel_shape=[convolution.size] * 2,
                strides=[convolution.stride] * 2,
                pads=[convolution.padding] * 4,
                group=convolution.groups,
            )
        case MaxPool(size, stride, padding):
            yield helper.make_node(
                "MaxPool",
                [before],
                [output],
                kernel_shape=[size] * 2,
                strides=[stride] * 2,
                pads=[padding // 2] * 2 + [padding - padding // 2] * 2,
            )
        case Upsample():
            yield helper.make_node(
                "Resize",
                [before, "", f"scales{layer.index}"],
                [output],
                mode="nearest",
                coordinate_transformation_mode="asymmetric",
                nearest_mode="floor",
            )
        case Route(sources):
            yield helper.make_node(
                "Concat", [output_of(network.layers[source]) for source in sources], [output], axis=1
            )
        case Shortcut(source, activation):
            yield from _activated("Add", [before, output_of(network.layers[source])], output, activation)
        case Yolo():
            yield helper.make_node("Identity", [before], [output])


def _activated(
    kind: str, inputs: list[str], output: str, activation: Activation, **attributes: Any
) -> Iterator[onnx.NodeProto]:
    from onnx import helper

    linear = output if activation == "linear" else f"{output}-linear"
    yield helper.make_node(kind, inputs, [linear], **attributes)
    if activation != "linear":
        slope: dict[str, Any] = {"alpha": LEAKY_SLOPE} if activation == "leaky" else {}
        yield helper.make_node(_ACTIVATION_NODES[activation], [linear], [output], **slope)


def input_of(layer: Layer, network: DarknetNetwork) -> str:
    """The name of the output of the layer before."""
    return output_of(network.layers[layer.index - 1]) if layer.index else INPUT


def output_of(layer: Layer) -> str:
    """The name of a layer's output."""
    return f"head{layer.index}" if isinstance(layer.operator, Yolo) else f"layer{layer.index}"
