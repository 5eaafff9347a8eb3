from dataclasses import replace

import pytest
import torch

from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.scene.splats import Splats, from_gaussians


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


def test_activated_values_are_those_that_are_rendered():
    splats = random_splats(50)
    means, quats, scales, opacities, sh = splats.activated()
    assert torch.equal(means, splats.means)
    torch.testing.assert_close(quats, torch.nn.functional.normalize(splats.quats))
    torch.testing.assert_close(scales, splats.scales.exp())
    torch.testing.assert_close(opacities, splats.opacities.sigmoid())
    assert torch.equal(sh, torch.cat([splats.sh0, splats.shN], dim=1))


def test_a_round_trip_keeps_splats_to_the_bit_in_64_bits_and_to_float32_else():
    splats = replace(random_splats(500), identities=None)
    splats = replace(splats, quats=splats.activated().quats)
    again = from_gaussians(*splats.map(torch.Tensor.double).activated())
    for name, tensor in splats.tensors().items():
        assert torch.equal(again.tensors()[name], tensor), name
    values = splats.activated()
    for name, found, value in zip(
        values._fields, from_gaussians(*values).activated(), values, strict=True
    ):
        torch.testing.assert_close(found, value, rtol=1e-6, atol=1e-7, msg=name)


def test_arrays_and_columns_of_opacities_are_taken():
    values = random_splats(9, sh_degree=1).activated()
    arrays = [value.numpy() for value in values]
    arrays[3] = arrays[3][:, None]
    for name, tensor in from_gaussians(*arrays).tensors().items():
        assert torch.equal(tensor, from_gaussians(*values).tensors()[name]), name


def test_an_opacity_of_0_or_1_stays_what_it_is():
    values = random_splats(2).activated()
    ends = from_gaussians(*values._replace(opacities=torch.tensor([0.0, 1.0])))
    assert ends.opacities.isfinite().all()
    torch.testing.assert_close(ends.activated().opacities, torch.tensor([0.0, 1.0]))


@pytest.mark.parametrize(
    ("field", "change", "fact"),
    [
        ("scales", torch.log, "logarithms"),
        ("opacities", lambda x: x + 1, "outside of 0..1"),
        ("quats", torch.zeros_like, "norm 0"),
        ("means", lambda x: x / 0, "means"),
        ("means", lambda x: x[1:], r"\[3, 3\]"),
        ("sh", lambda x: x[:, :5], "5 bands"),
        ("sh", lambda x: x[:, 0], r"\[4, 3\]"),
    ],
)
def test_values_that_are_no_gaussians_are_refused(field: str, change, fact: str):
    values = random_splats(4).activated()
    values = values._replace(scales=values.scales.clamp(max=0.5))
    with pytest.raises(StyleSplatError, match=fact):
        from_gaussians(*values._replace(**{field: change(getattr(values, field))}))
