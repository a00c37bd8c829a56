"""The exported network with weights of 8 bits: half the file, the same sums.

Each weight is stored as an integer and a scale for its output channel. onnxruntime multiplies them when it
loads the file, so that a picture takes as long as before: it computes Cast and Mul then, DequantizeLinear
again for each picture. Needs `training/requirements.txt` (onnx).
"""

from __future__ import annotations

import numpy as np
import onnx
from onnx import numpy_helper

_LEVELS = 127
_KEPT = tuple(f"second_{name}_w_fp16" for name in ("clear", "foul", "is_clear", "nothing"))
"""Weights that stay as they are: for channels that vary little they are large, and 127 levels up to those
would make the others 0."""


def compact(data: bytes) -> bytes:
    """An ONNX file as `network.export` writes it -> the same with weights of 8 bits."""
    model = onnx.load_from_string(data)
    graph = model.graph
    stored = {one.name: one for one in graph.initializer}
    nodes: list[onnx.NodeProto] = []
    for node in graph.node:
        half = stored.get(node.input[0]) if node.op_type == "Cast" else None
        if half is None or half.data_type != onnx.TensorProto.FLOAT16 or half.name in _KEPT:
            nodes.append(node)
            continue
        del stored[half.name]
        (name,) = node.output
        integers, scale = _rounded(numpy_helper.to_array(half).astype(np.float32))
        for suffix, values in (("i8", integers), ("scale", scale)):
            stored[f"{name}_{suffix}"] = numpy_helper.from_array(values, f"{name}_{suffix}")
        whole = onnx.helper.make_node("Cast", [f"{name}_i8"], [f"{name}_whole"], to=onnx.TensorProto.FLOAT)
        nodes += [whole, onnx.helper.make_node("Mul", [f"{name}_whole", f"{name}_scale"], [name])]
    del graph.node[:], graph.initializer[:]
    graph.node.extend(nodes)
    graph.initializer.extend(stored.values())
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def is_compact(data: bytes) -> bool:
    """Whether the weights of an ONNX file have 8 bits."""
    stored = onnx.load_from_string(data).graph.initializer
    return any(one.data_type == onnx.TensorProto.INT8 for one in stored)


def _rounded(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """int8 of the same shape, and the scale (outputs, 1, ...) that makes weights of it."""
    scale = np.abs(weights).reshape(len(weights), -1).max(axis=1) / _LEVELS
    scale = np.maximum(scale, np.finfo(np.float32).tiny).astype(np.float32)
    scale = scale.reshape(-1, *[1] * (weights.ndim - 1))
    return np.rint(weights / scale).astype(np.int8), scale
