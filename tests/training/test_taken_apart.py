import pytest
import torch

from stylesplat.training.taken_apart import taken_apart


@pytest.mark.parametrize(("offset", "stride"), [((0, 0), 1), ((1, 2), 3), ((4, 0), 5)])
def test_is_what_slices_are(offset: tuple[int, int], stride: int):
    render = torch.randn(7, 11, 19, generator=torch.Generator().manual_seed(0)).requires_grad_()
    colors, features = taken_apart(render, offset, stride)
    y, x = offset
    expected = render[..., :3], render[y::stride, x::stride, 3:]
    assert torch.equal(colors, expected[0]) and torch.equal(features, expected[1])
    weights = torch.rand_like(colors), torch.rand_like(features)
    (found,) = torch.autograd.grad([colors, features], render, weights)
    (wanted,) = torch.autograd.grad(expected, render, weights)
    assert torch.equal(found, wanted)


def test_gradients_are_those_of_differences():
    render = torch.rand(3, 4, 5, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda each: taken_apart(each, (1, 0), 2), render)


def test_either_part_may_be_of_no_matter():
    render = torch.rand(4, 6, 19, requires_grad=True)
    colors, features = taken_apart(render, (1, 1), 2)
    (found,) = torch.autograd.grad(features.sum(), render, retain_graph=True)
    assert found.sum() == features.numel() and not found[..., :3].any()
    (found,) = torch.autograd.grad(colors.sum(), render)
    assert found.sum() == colors.numel() and not found[..., 3:].any()
