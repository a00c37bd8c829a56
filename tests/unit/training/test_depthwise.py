"""The training's own gradients against torch's."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch", reason="needs pip install -r training/requirements.txt")

from training.depthwise import Depthwise, same_padding  # noqa: E402


@pytest.mark.parametrize("side", [11, 12])
@pytest.mark.parametrize("kernel", [3, 5])
@pytest.mark.parametrize("stride", [1, 2])
def test_it_answers_and_learns_as_torchs_own_convolution_does(side: int, kernel: int, stride: int) -> None:
    torch.manual_seed(0)
    own = torch.nn.Conv2d(8, 8, kernel, stride, groups=8, bias=False)
    x = torch.randn(2, 8, side, side).to(memory_format=torch.channels_last).requires_grad_()
    before, behind = same_padding(side, kernel, stride)
    expected = own(torch.nn.functional.pad(x, (before, behind, before, behind)))
    found = Depthwise(own)(x)
    assert found.shape[-1] == -(-side // stride)
    torch.testing.assert_close(found, expected)
    gradient = torch.randn_like(expected)
    torch.testing.assert_close(
        torch.autograd.grad(found, (x, own.weight), gradient),
        torch.autograd.grad(expected, (x, own.weight), gradient),
    )


@pytest.mark.parametrize(("side", "expected"), [(12, (0, 1)), (11, (1, 1))])
def test_the_odd_pixel_of_the_padding_goes_behind(side: int, expected: tuple[int, int]) -> None:
    assert same_padding(side, kernel=3, stride=2) == expected
