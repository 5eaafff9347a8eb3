import math
from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from scenes import random_splats, two_cameras
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.render import rasterize
from stylesplat.scene.splats import Splats
from stylesplat.training import densification
from stylesplat.training.adam import Moments
from stylesplat.training.densification import growth_preference, limit_sizes, object_share
from stylesplat.training.device_ops import DEAD_OPACITY, NOISE_SHARPNESS

NAMES = ("means", "quats", "scales", "opacities", "sh0", "shN", "identities")


def refined(splats: Splats, count: int) -> tuple[dict[str, torch.Tensor], Moments]:
    params = splats.tensors()
    ones = {name: torch.ones_like(t) for name, t in params.items()}
    generator = torch.Generator().manual_seed(0)
    return densification.relocate_and_grow(params, Moments(ones, ones), NAMES, count, generator)


def faint(count: int = 40) -> Splats:
    splats = random_splats(count)
    splats.opacities[:] = -6.0
    return splats


def normal(params: dict[str, torch.Tensor]) -> torch.Tensor:
    return torch.randn(params["means"].shape, generator=torch.Generator().manual_seed(0))


def test_grows_to_the_count():
    params, moments = refined(random_splats(50), 80)
    assert all(len(params[name]) == 80 for name in NAMES)
    assert all(len(moments.first[name]) == 80 for name in NAMES)
    assert not moments.first["means"][50:].any(), "copies start from zero moments"


def test_dead_gaussians_move_to_living_ones():
    splats = random_splats(50)
    splats.opacities[:10] = -9.0
    params, moments = refined(splats, 50)
    assert (torch.sigmoid(params["opacities"]) > DEAD_OPACITY * 0.99).all()
    moved = params["means"][:10]
    assert (moved[:, None] == splats.means[None, 10:]).all(-1).any(1).all()
    assert not moments.second["means"][:10].any()


def test_copies_look_like_their_source():
    # Opacity 0.6 in the middle of the image: one Gaussian against it and three copies.
    one = random_splats(1, sh_degree=0)
    one.means[:], one.opacities[:], one.scales[:] = 0, 0.4, -1.5
    params, _ = refined(one, 4)
    many = replace(one, **params)
    camera = two_cameras()[:1]
    before, after = rasterize(one, camera)[1], rasterize(many, camera)[1]
    assert (before - after).abs().mean() < 0.02 * before.max()
    naive = one[torch.zeros(4, dtype=torch.long)]
    wrong = rasterize(naive, camera)[1]
    assert (before - after).abs().mean() < 0.2 * (before - wrong).abs().mean()


def test_nothing_to_do_changes_nothing():
    splats = random_splats(20)
    splats.opacities.abs_()
    params, moments = refined(splats, 20)
    assert params["means"] is splats.means
    assert moments.first["means"].all()


def test_noise_moves_faint_gaussians_only():
    splats = random_splats(40)
    splats.opacities[:20], splats.opacities[20:] = -6.0, 3.0
    params = {name: t.clone() for name, t in splats.tensors().items()}
    densification.perturb_means(params, 1.0, 1.0, normal(params))
    moved = (params["means"] - splats.means).norm(dim=-1)
    assert moved[:20].min() > 0
    assert moved[20:].max() < 1e-6 * moved[:20].mean()


def test_regularizer_pulls_down_opacity_and_size():
    params = {name: t.requires_grad_() for name, t in random_splats(9).tensors().items()}
    densification.regularizer(params, 1.0).backward()
    for name in ("opacities", "scales"):
        gradient = params[name].grad
        assert gradient is not None and (gradient > 0).all()


def test_preferred_gaussians_are_copied():
    splats = random_splats(50)
    preference = torch.where(torch.arange(50) < 10, 1.0, 0.0)
    generator = torch.Generator().manual_seed(0)
    moments = Moments.zeros(splats.tensors())
    params, _ = densification.relocate_and_grow(
        splats.tensors(), moments, NAMES, 80, generator, preference=preference
    )
    copies = params["means"][50:]
    assert (copies[:, None] == splats.means[None, :10]).all(-1).any(1).all()


def test_noise_follows_the_covariance():
    # 20,000 equal Gaussians: the sample covariance is within a few percent of Sigma Sigma.
    one = random_splats(1, seed=4)
    one.opacities[:] = -20.0
    params = {n: t.repeat(20_000, *[1] * (t.ndim - 1)) for n, t in one.tensors().items()}
    before = params["means"].clone()
    densification.perturb_means(params, 1.0, 1.0, normal(params))
    moved = params["means"] - before
    axes = rotation_matrices(one.quats)[0] * one.scales[0].exp()
    sigma = axes @ axes.T
    gate = torch.sigmoid(torch.tensor(NOISE_SHARPNESS * DEAD_OPACITY))
    expected = (densification.NOISE_RATE * gate) ** 2 * sigma @ sigma
    assert (moved.T.cov() - expected).norm() < 0.05 * expected.norm()


def test_noise_and_regularizer_do_not_depend_on_the_unit_of_length():
    def learned(factor: float) -> tuple[torch.Tensor, torch.Tensor]:
        params = {name: t.clone() for name, t in faint().tensors().items()}
        params["means"] *= factor
        params["scales"] += math.log(factor)
        densification.perturb_means(params, factor, 1.0, normal(params))
        return params["means"] / factor, densification.regularizer(params, factor)

    for one, other in zip(learned(1.0), learned(100.0), strict=True):
        assert torch.allclose(one, other, rtol=1e-4)


def test_refining_keeps_what_a_scene_looks_like():
    # Half of the Gaussians are dead, and the number doubles, so nearly all that show are copied.
    splats = random_splats(60, sh_degree=0)
    splats.opacities[30:] = -9.0
    splats.opacities[:30] = splats.opacities[:30].clamp(max=1.0)
    params, _ = refined(splats, 120)
    scenes = (splats, replace(splats, **params), splats[rows_of(params, splats)])
    before, after, unshrunk = (rasterize(scene, two_cameras())[0] for scene in scenes)
    # Equation 9 keeps what a Gaussian contributes in all, not its exact profile: 5% measured.
    error, unshrunk_error = (before - after).abs().mean(), (before - unshrunk).abs().mean()
    assert error < 0.08 * before.mean()
    assert error < 0.35 * unshrunk_error


def rows_of(params: dict[str, torch.Tensor], splats: Splats) -> torch.Tensor:
    """Where each Gaussian came from."""
    same = (params["means"][:, None] == splats.means[None]).all(dim=-1)
    return same.int().argmax(dim=1)


def test_refining_copies_all_but_opacity_and_size():
    splats = random_splats(40)
    params, _ = refined(splats, 90)
    rows = rows_of(params, splats)
    for name in ("means", "quats", "sh0", "shN", "identities"):
        assert torch.equal(params[name], splats.tensors()[name][rows]), name


def test_who_was_not_drawn_stays_bit_equal():
    splats = random_splats(40)
    params, moments = refined(splats, 60)
    rows = rows_of(params, splats)
    alone = torch.bincount(rows, minlength=40) == 1
    assert 5 < int(alone.sum()) < 40
    alone &= torch.sigmoid(splats.opacities) > DEAD_OPACITY
    for name, tensor in splats.tensors().items():
        assert torch.equal(params[name][:40][alone], tensor[alone]), name
        assert (moments.first[name][:40][alone] == 1).all(), name


def test_fewer_than_there_are_removes_none():
    splats = random_splats(40)
    assert len(refined(splats, 10)[0]["means"]) == 40


def test_growing_follows_from_its_generator():
    splats = random_splats(30)
    one, other = (refined(splats, 60)[0] for _ in range(2))
    assert torch.equal(one["means"], other["means"])
    moments = Moments.zeros(splats.tensors())
    generator = torch.Generator().manual_seed(1)
    third, _ = densification.relocate_and_grow(splats.tensors(), moments, NAMES, 60, generator)
    assert not torch.equal(one["means"], third["means"])


OBJECTS = torch.arange(len(SPLATS)) >= 200  # the table comes first


def test_share_is_the_probability_of_not_being_background():
    share = object_share(SPLATS)
    assert share is not None
    assert (share[OBJECTS] > 0.99).all()
    assert (share[~OBJECTS] < 0.01).all()
    assert object_share(replace(SPLATS, identities=None)) is None


def test_objects_are_preferred():
    preference = growth_preference(SPLATS, 4.0)
    assert preference is not None
    assert preference[OBJECTS].mean() == pytest.approx(4.0, abs=0.05)
    assert preference[~OBJECTS].mean() == pytest.approx(1.0, abs=0.05)


def test_only_large_gaussians_of_objects_shrink():
    scales = SPLATS.scales.clone()
    scales[0] = scales[200] = 0.0
    splats = replace(SPLATS, scales=scales.clone())
    limit_sizes(splats, CAMERAS, 2.0)
    distance = 3.354  # of the cameras from the middle, at a focal length of 50 pixels
    assert splats.scales[200].exp().tolist() == pytest.approx([2 * distance / 50] * 3, rel=0.1)
    scales[200] = splats.scales[200]
    assert torch.equal(splats.scales, scales), "all others stay"


def test_limits_scale_with_the_pixels():
    limits = []
    for pixels in (1.0, 2.0):
        splats = replace(SPLATS, scales=torch.full_like(SPLATS.scales, 3.0))
        limit_sizes(splats, CAMERAS, pixels)
        limits.append(splats.scales[200].exp())
    assert torch.allclose(2 * limits[0], limits[1], rtol=1e-5)


def test_without_objects_nothing_shrinks():
    for splats in (replace(SPLATS, identities=None), SPLATS[~OBJECTS]):
        large = replace(splats, scales=torch.full_like(splats.scales, 3.0))
        limit_sizes(large, CAMERAS, 2.0)
        assert (large.scales == 3).all()
