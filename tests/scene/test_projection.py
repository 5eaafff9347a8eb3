import pytest
import torch

from stylesplat.scene.projection import overlapping


@pytest.mark.parametrize("size", [0.0, 0.3])
@pytest.mark.parametrize("axes", [1, 2, 3])
def test_it_is_what_all_axes_share(axes: int, size: float):
    generator = torch.Generator().manual_seed(axes)
    lows = torch.rand(500, axes, generator=generator)
    low, high = torch.full((axes,), 0.4), torch.full((axes,), 0.7)
    shared = ((lows <= high) & (lows + size >= low)).all(dim=1)
    assert 0 < int(shared.sum()) < 500
    found = overlapping(lows, lows + size, low, high)
    assert torch.equal(found, shared.nonzero()[:, 0])
