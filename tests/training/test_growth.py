from dataclasses import replace

import torch

from scenes import random_splats, two_cameras
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.scene.splats import Splats
from stylesplat.training import growth as mcmc
from stylesplat.training.adam import Moments

NAMES = ("means", "quats", "scales", "opacities", "sh0", "shN", "identities")


def refined(splats: Splats, count: int) -> tuple[dict[str, torch.Tensor], Moments]:
    params = splats.tensors()
    ones = {name: torch.ones_like(t) for name, t in params.items()}
    generator = torch.Generator().manual_seed(0)
    return mcmc.refine(params, Moments(ones, ones), NAMES, count, generator)


def test_grows_to_the_count():
    params, moments = refined(random_splats(50), 80)
    assert all(len(params[name]) == 80 for name in NAMES)
    assert all(len(moments.first[name]) == 80 for name in NAMES)
    assert not moments.first["means"][50:].any(), "copies start from zero moments"


def test_dead_gaussians_move_to_living_ones():
    splats = random_splats(50)
    splats.opacities[:10] = -9.0
    params, moments = refined(splats, 50)
    assert (torch.sigmoid(params["opacities"]) > mcmc.DEAD_OPACITY * 0.99).all()
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
    mcmc.add_noise(params, 1.0, torch.Generator().manual_seed(0))
    moved = (params["means"] - splats.means).norm(dim=-1)
    assert moved[:20].min() > 0
    assert moved[20:].max() < 1e-6 * moved[:20].mean()


def test_regularizer_pulls_down_opacity_and_size():
    params = {name: t.requires_grad_() for name, t in random_splats(9).tensors().items()}
    mcmc.regularizer(params).backward()
    for name in ("opacities", "scales"):
        gradient = params[name].grad
        assert gradient is not None and (gradient > 0).all()


def test_preferred_gaussians_are_copied():
    splats = random_splats(50)
    preference = torch.where(torch.arange(50) < 10, 1.0, 0.0)
    generator = torch.Generator().manual_seed(0)
    moments = Moments.zeros(splats.tensors())
    params, _ = mcmc.refine(splats.tensors(), moments, NAMES, 80, generator, preference=preference)
    copies = params["means"][50:]
    assert (copies[:, None] == splats.means[None, :10]).all(-1).any(1).all()


def test_noise_follows_the_covariance():
    # 20,000 equal Gaussians: the sample covariance is within a few percent of Sigma Sigma.
    one = random_splats(1, seed=4)
    one.opacities[:] = -20.0
    params = {n: t.repeat(20_000, *[1] * (t.ndim - 1)) for n, t in one.tensors().items()}
    before = params["means"].clone()
    mcmc.add_noise(params, 1.0, torch.Generator().manual_seed(0))
    moved = params["means"] - before
    axes = rotation_matrices(one.quats)[0] * one.scales[0].exp()
    sigma = axes @ axes.T
    gate = torch.sigmoid(torch.tensor(mcmc.NOISE_SHARPNESS * mcmc.DEAD_OPACITY))
    expected = (mcmc.NOISE_RATE * gate) ** 2 * sigma @ sigma
    assert (moved.T.cov() - expected).norm() < 0.05 * expected.norm()


def test_noise_kernel_matches_torch():
    splats, generator = random_splats(500), torch.Generator().manual_seed(0)
    faint = splats.opacities.sub_(4) < mcmc.OPAQUE
    noise = torch.randn(500, 3, generator=generator)
    names = ("means", "quats", "scales", "opacities")
    fast, slow = ([splats.tensors()[n].clone() for n in names] for _ in range(2))
    mcmc._drift_cpu(tuple(t.numpy() for t in (*fast, noise)), 100.0)
    mcmc._drift_torch((*slow, noise), 100.0)
    # In those that the kernel leaves out, the gate is below 1e-6.
    assert torch.allclose(fast[0][faint], slow[0][faint], atol=1e-5)
    assert torch.allclose(fast[0][~faint], slow[0][~faint], atol=1e-3)
    assert (fast[0] - splats.means)[faint].abs().max() > 0.1
