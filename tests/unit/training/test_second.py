"""The second opinion: what it sees is ImageNet's, and its layers are the best of those that are linear."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch", reason="needs pip install -r training/requirements.txt")

from training.second import POOLED_BLOCKS, Second, Views, fitted  # noqa: E402

OWN = torch.tensor([[3.0, 1.0, 0.0, -1.0, 0.0, 2.0, -2.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0]])
PICTURES = torch.linspace(-1, 1, 2 * 3 * 64 * 64).reshape(2, 3, 64, 64)


@pytest.fixture
def opinion() -> Second:
    return Second(classes=6, share=1.5, foul_share=0.5, alone=2.0, nothing_share=0.5)


def views(label: torch.Tensor, first: int, channels: int) -> Views:
    """Each class at a channel of its own, from the `first` on."""
    torch.manual_seed(first)
    seen = 0.3 * torch.randn(len(label), channels)
    seen += torch.nn.functional.one_hot(label + first, channels)
    return Views(seen, torch.nn.functional.one_hot(label, 6).float())


def test_it_learns_nothing_in_steps(opinion: Second) -> None:
    opinion.train()
    assert not any(module.training for module in opinion.modules())
    assert not any(parameter.requires_grad for parameter in opinion.parameters())


def test_each_picture_has_mean_and_spread_of_the_pooled_blocks_maps(opinion: Second) -> None:
    maps = {}
    for index in POOLED_BLOCKS:
        layer = opinion.blocks[index]._project_conv
        layer.register_forward_pre_hook(lambda _layer, seen, index=index: maps.update({index: seen[0]}))
    found = opinion.features(PICTURES)
    assert found.shape == (2, opinion.clear.in_features)
    means, spreads = found.chunk(2, dim=1)
    torch.testing.assert_close(means, torch.cat([maps[index].mean((2, 3)) for index in POOLED_BLOCKS], dim=1))
    apart = [maps[index] - maps[index].mean((2, 3), keepdim=True) for index in POOLED_BLOCKS]
    torch.testing.assert_close(
        spreads.square(), torch.cat([one.square().mean((2, 3)) for one in apart], dim=1), atol=1e-4, rtol=1e-4
    )
    torch.testing.assert_close(found[:1], opinion.features(PICTURES[:1]), atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize(("bias", "share", "own"), [(100.0, 1.5, 1.0), (-100.0, 0.5, 2.0)])
def test_what_is_no_item_stays_none_and_no_class_gains_be_it_clear_or_foul(
    opinion: Second, bias: float, share: float, own: float
) -> None:
    opinion.is_clear.bias.fill_(bias)
    opinion.nothing.bias.fill_(-100.0)
    added = opinion(PICTURES, OWN) - own * OWN
    assert added.shape == (2, 7) and (added[:, 6].abs() < 1e-6).all() and (added[:, :6] < 0).all()
    torch.testing.assert_close((added[:, :6] / share).exp().sum(1), torch.ones(2), atol=1e-4, rtol=0)


def test_where_no_item_is_more_probable_that_counts_for_none_of_them_alone(opinion: Second) -> None:
    opinion.is_clear.bias.fill_(100.0)
    opinion.nothing.weight.zero_()
    opinion.nothing.bias.fill_(-3.0)
    before = opinion(PICTURES, OWN)
    opinion.nothing.bias.fill_(3.0)
    torch.testing.assert_close(opinion(PICTURES, OWN) - before, torch.tensor([[0.0] * 6 + [1.5]] * 2))


def test_of_clear_pictures_one_layer_is_heard_and_of_others_the_other(opinion: Second) -> None:
    opinion.clear.bias[0], opinion.foul.bias[1] = 50.0, 50.0
    for bias, best in ((100.0, 0), (-100.0, 1)):
        opinion.is_clear.bias.fill_(bias)
        assert opinion(PICTURES, torch.zeros(2, 7))[:, :6].argmax(1).tolist() == [best, best]


def test_it_tells_classes_of_clear_and_of_foul_views_and_which_are_which(opinion: Second) -> None:
    channels, label = opinion.clear.in_features, torch.arange(120) % 6
    clear, foul = views(label, 0, channels), views(label.flip(0), 10, channels)
    nothing = 0.3 * torch.randn(60, channels) - 1.0
    opinion.learn(clear, [foul], nothing, ridge=1e-3, foul_ridge=1e-3)
    assert (opinion.clear(clear.features).argmax(1) == label).float().mean() > 0.95
    assert (opinion.foul(foul.features).argmax(1) == label.flip(0)).float().mean() > 0.95
    seen = [torch.sigmoid(opinion.is_clear(one)).mean() for one in (clear.features, foul.features, nothing)]
    assert seen[0] > 0.9 and max(seen[1:]) < 0.1
    assert (opinion.nothing(nothing) > 0).all()
    assert not (opinion.nothing(torch.cat([clear.features, foul.features])) > 0).any()


def test_views_count_by_their_share_however_many_they_are(opinion: Second) -> None:
    channels = opinion.clear.in_features
    same = torch.zeros(1, channels)
    one, other = torch.eye(6)[:1], torch.eye(6)[1:2]
    many, few = Views(same.expand(90, -1), one.expand(90, 6), 0.25), Views(same, other, 0.75)
    clear = Views(torch.randn(20, channels), torch.eye(6)[torch.arange(20) % 6])
    opinion.learn(clear, [many, few], same, ridge=1e-3, foul_ridge=1.0)
    said = torch.softmax(opinion.foul(same), dim=1)[0]
    assert 2.5 < float(said[1] / said[0]) < 3.5


def test_a_channel_that_hardly_varies_does_not_decide(opinion: Second) -> None:
    """Its noise would be enlarged, and weights of 16 bits could not hold it."""
    channels, label = opinion.clear.in_features, torch.arange(60) % 6
    clear = views(label, 1, channels)
    clear.features[:, 0] = 1e-6 * label
    opinion.learn(clear, [clear], clear.features + 9.0, ridge=1e-3, foul_ridge=1e-3)
    assert max(float(layer.weight.abs().max()) for layer in (opinion.clear, opinion.foul)) < 100


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
