from dataclasses import replace

import pytest
import torch

from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.scene.splats import Splats


def test_other_values_in_some_rows():
    splats, rows = random_splats(6), torch.tensor([4, 1])
    part = torch.zeros(2, 3, requires_grad=True)
    changed = splats.with_rows(rows, {"scales": part, "opacities": torch.ones(2)})
    assert not changed.scales[rows].any() and changed.opacities[rows].tolist() == [1, 1]
    others = torch.tensor([0, 2, 3, 5])
    for name, tensor in changed.tensors().items():
        assert torch.equal(tensor[others], splats.tensors()[name][others]), name
    assert changed.means is splats.means and changed.classifier is splats.classifier
    (gradient,) = torch.autograd.grad(changed.scales.sum(), part)
    assert (gradient == 1).all()


def test_parts_put_together_are_the_whole():
    splats = random_splats(6)
    parts = [splats[:2], splats[torch.tensor([2, 3])], splats[torch.arange(6) > 3], splats[:0]]
    for name, tensor in Splats.cat(parts).tensors().items():
        assert torch.equal(tensor, splats.tensors()[name]), name


def test_antialiased_splats_stay_so_and_are_not_joined_with_others():
    splats = replace(random_splats(6), antialiased=True)
    made = (splats[:2], splats.map(torch.clone), splats.detach(), splats.to("cpu"))
    assert all(each.antialiased for each in (*made, Splats.cat([splats[:2], splats[2:]])))
    assert "antialiased" in repr(splats)
    with pytest.raises(StyleSplatError, match="anti-aliased"):
        Splats.cat([splats, random_splats(6)])
    assert not Splats.cat([splats[:0], random_splats(6)]).antialiased


def test_map_reaches_every_tensor():
    doubled = random_splats(6).map(lambda tensor: 2 * tensor)
    for name, tensor in random_splats(6).tensors().items():
        assert torch.equal(doubled.tensors()[name], 2 * tensor), name
