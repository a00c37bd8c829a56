"""The exported network with weights of 8 bits: half the file, the same sums.

Each weight is stored as an integer and a scale for its output channel. OpenCV multiplies them when it loads
the file, so that a picture takes as long as before. Needs the `train` extra (onnx).
"""

from __future__ import annotations

import numpy as np
import onnx
from onnx import numpy_helper

_LEVELS = 127


def compact(data: bytes) -> bytes:
    """An ONNX file as `network.export` writes it -> the same with weights of 8 bits."""
    model = onnx.load_from_string(data)
    graph = model.graph
    stored = {one.name: one for one in graph.initializer}
    nodes: list[onnx.NodeProto] = []
    for node in graph.node:
        half = stored.get(node.input[0]) if node.op_type == "Cast" else None
        if half is None or half.data_type != onnx.TensorProto.FLOAT16:
            nodes.append(node)
            continue
        del stored[half.name]
        (name,) = node.output
        integers, scale = _rounded(numpy_helper.to_array(half).astype(np.float32))
        inputs = []
        for suffix, values in (("i8", integers), ("scale", scale), ("zero", np.zeros(len(scale), np.int8))):
            inputs.append(f"{name}_{suffix}")
            stored[inputs[-1]] = numpy_helper.from_array(values, inputs[-1])
        nodes.append(onnx.helper.make_node("DequantizeLinear", inputs, [name], axis=0))
    del graph.node[:], graph.initializer[:]
    graph.node.extend(nodes)
    graph.initializer.extend(stored.values())
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def _rounded(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """int8 of the same shape, and the scale (outputs,) that makes weights of it."""
    scale = np.abs(weights).reshape(len(weights), -1).max(axis=1) / _LEVELS
    scale = np.maximum(scale, np.finfo(np.float32).tiny).astype(np.float32)
    shape = (-1, *[1] * (weights.ndim - 1))
    return np.rint(weights / scale.reshape(shape)).astype(np.int8), scale
