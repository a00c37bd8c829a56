"""The second opinion: what it sees is ImageNet's, and its head is the best of those that are linear."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch", reason="needs the train extra: pip install -e '.[train]'")

from services.itrash.training.second import POOLED_BLOCKS, Second, fitted  # noqa: E402

OWN = torch.tensor([[3.0, 1.0, 0.0, -1.0, 0.0, 2.0, -2.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0]])
PICTURES = torch.linspace(-1, 1, 2 * 3 * 64 * 64).reshape(2, 3, 64, 64)


@pytest.fixture
def opinion() -> Second:
    return Second(classes=6, share=1.5, alone=2.0)


def test_it_learns_nothing_in_steps(opinion: Second) -> None:
    opinion.train()
    assert not any(module.training for module in opinion.modules())
    assert not any(parameter.requires_grad for parameter in opinion.parameters())


def test_each_picture_has_the_means_of_the_pooled_blocks_maps(opinion: Second) -> None:
    maps = {}
    for index in POOLED_BLOCKS:
        layer = opinion.blocks[index]._project_conv
        layer.register_forward_pre_hook(lambda _layer, seen, index=index: maps.update({index: seen[0]}))
    found = opinion.features(PICTURES)
    assert found.shape == (2, opinion.classes.in_features)
    torch.testing.assert_close(found, torch.cat([maps[index].mean((2, 3)) for index in POOLED_BLOCKS], dim=1))
    torch.testing.assert_close(found[:1], opinion.features(PICTURES[:1]), atol=1e-4, rtol=1e-4)


def test_what_is_no_item_stays_none_and_no_class_gains(opinion: Second) -> None:
    opinion.known.bias.fill_(100.0)
    added = opinion(PICTURES, OWN) - OWN
    assert added.shape == (2, 7) and (added[:, 6].abs() < 1e-6).all() and (added[:, :6] < 0).all()
    torch.testing.assert_close((added[:, :6] / 1.5).exp().sum(1), torch.ones(2), atol=1e-4, rtol=0)


def test_of_a_picture_of_no_known_kind_nothing_is_said_and_the_other_is_as_sure_as_it_is_alone(
    opinion: Second,
) -> None:
    opinion.known.bias.fill_(-100.0)
    torch.testing.assert_close(opinion(PICTURES, OWN), 2.0 * OWN)


def test_it_tells_classes_of_what_it_knows_and_hears_itself_nowhere_else(opinion: Second) -> None:
    torch.manual_seed(0)
    channels = opinion.classes.in_features
    label = torch.arange(120) % 6
    known = 0.3 * torch.randn(120, channels) + torch.nn.functional.one_hot(label, channels).float()
    others = [0.3 * torch.randn(60, channels) + away for away in (1.0, -1.0)]
    opinion.learn(known, torch.nn.functional.one_hot(label, 6).float(), others, ridge=1e-3)
    assert (opinion.classes(known).argmax(1) == label).float().mean() > 0.95
    heard = [torch.sigmoid(opinion.known(one)).mean() for one in (known, *others)]
    assert heard[0] > 0.9 and max(heard[1:]) < 0.1


def test_a_channel_that_hardly_varies_does_not_decide(opinion: Second) -> None:
    """Its noise would be enlarged, and weights of 16 bits could not hold it."""
    torch.manual_seed(0)
    channels = opinion.classes.in_features
    known = torch.randn(60, channels)
    label = torch.arange(60) % 6
    known[:, 0] = 1e-6 * label
    opinion.learn(known, torch.nn.functional.one_hot(label, 6).float(), [known + 9.0], ridge=1e-3)
    assert float(opinion.classes.weight.abs().max()) < 100


def test_the_ridge_keeps_a_layer_from_being_surer_than_few_pictures_allow() -> None:
    torch.manual_seed(0)
    features, noise = torch.randn(50, 200), torch.nn.functional.one_hot(torch.arange(50) % 2, 2).float()

    def loss_on_others(ridge: float) -> float:
        weight, bias = fitted(features, noise, torch.ones(50), ridge)
        said = torch.randn(500, 200) @ weight.T + bias
        return float(torch.nn.functional.cross_entropy(said, torch.full((500, 2), 0.5)))

    assert loss_on_others(0.3) < loss_on_others(1e-4)


def test_pictures_count_as_much_as_is_asked() -> None:
    features = torch.zeros(4, 3)
    targets = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    _, bias = fitted(features, targets, torch.tensor([6.0, 1.0, 1.0, 0.0]), ridge=1.0)
    torch.testing.assert_close(torch.softmax(bias, 0), torch.tensor([0.75, 0.25]), atol=1e-3, rtol=0)
