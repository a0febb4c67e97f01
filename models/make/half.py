"""Stores the weights of a network as 16-bit floats; the runtime makes 32-bit floats of them when it loads the file."""

import numpy as np
import onnx
from onnx import numpy_helper

# Smaller tensors are shapes, scales and biases: they save nothing.
LEAST_VALUES = 256


def half(tensor: onnx.TensorProto) -> onnx.TensorProto | None:
    """The tensor in 16 bits; nothing for one that is not worth it or does not fit."""
    if tensor.data_type != onnx.TensorProto.FLOAT:
        return None
    values = numpy_helper.to_array(tensor)
    if values.size < LEAST_VALUES or np.abs(values).max() > np.finfo(np.float16).max:
        return None
    return numpy_helper.from_array(values.astype(np.float16), f"{tensor.name}.half")


def with_half_weights(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same network with every large 32-bit float weight stored as 16 bits, and a cast behind it."""
    graph = model.graph
    weights = []
    for tensor in graph.initializer:
        stored = half(tensor)
        if stored is not None:
            weights.append(onnx.helper.make_node("Cast", [stored.name], [tensor.name], to=onnx.TensorProto.FLOAT))
            tensor.CopyFrom(stored)
    others = []
    for node in graph.node:
        others.append(node)
        value = next((a for a in node.attribute if node.op_type == "Constant" and a.name == "value"), None)
        stored = half(value.t) if value is not None else None
        if stored is not None:
            (name,) = node.output
            value.t.CopyFrom(stored)
            node.output[0] = f"{name}.half"
            others.append(onnx.helper.make_node("Cast", [f"{name}.half"], [name], to=onnx.TensorProto.FLOAT))
    nodes = [*weights, *others]
    del graph.node[:]
    graph.node.extend(nodes)
    onnx.checker.check_model(model, full_check=True)
    return model
