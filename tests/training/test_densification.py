import math
from dataclasses import replace

import pytest
import torch

from balls import SPLATS
from rendering import emulated_cuda
from scenes import randn, random_splats, two_cameras
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.render import rasterize
from stylesplat.scene.splats import Splats
from stylesplat.training.adam import Moments
from stylesplat.training.densification import (
    DEAD_OPACITY,
    LEAST_CHANGE,
    MAX_COPIES,
    NOISE_RATE,
    NOISE_SHARPNESS,
    add_gradients,
    add_noise_cpu,
    add_noise_cuda,
    growth_preference,
    perturb_means,
    regularizer,
    relocate,
    relocate_and_grow,
    take_scores,
    without_hidden,
)

NAMES = ("means", "quats", "scales", "opacities", "sh0", "shN", "identities")
OBJECTS = torch.arange(len(SPLATS)) >= 200  # the table comes first


def refined(
    splats: Splats, count: int, preference: torch.Tensor | None = None
) -> tuple[dict[str, torch.Tensor], Moments]:
    params = splats.tensors()
    ones = ({name: torch.ones_like(t) for name, t in params.items()} for _ in range(2))
    moments, generator = Moments(*ones), torch.Generator().manual_seed(0)
    optimizers = moments.optimizers(params)
    relocate_and_grow(params, optimizers, count, generator, preference=preference)
    return params, moments.updated(optimizers)


def rows_of(params: dict[str, torch.Tensor], splats: Splats) -> torch.Tensor:
    """Where each Gaussian came from."""
    same = (params["sh0"][:, None] == splats.sh0[None]).all(dim=-1).squeeze(-1)
    return same.int().argmax(dim=1)


def are_copied(rows: torch.Tensor) -> torch.Tensor:
    """Which Gaussians came from where others came from, too."""
    return torch.bincount(rows)[rows] > 1


def test_grows_to_the_count_by_copies_of_living_gaussians():
    splats = random_splats(50)
    params, moments = refined(splats, 80)
    assert all(len(params[name]) == len(moments.first[name]) == 80 for name in NAMES)
    rows = rows_of(params, splats)
    copied = are_copied(rows)
    assert not moments.first["means"][copied].any(), "copies start from zero moments"
    for name in ("quats", "sh0", "shN", "identities"):
        assert torch.equal(params[name], splats.tensors()[name][rows]), name
    assert 5 < int((~copied).sum()) < 50
    for name, tensor in splats.tensors().items():  # what was not copied stays as it was
        assert torch.equal(params[name][~copied], tensor[rows[~copied]]), name
        assert (moments.first[name][~copied] == 1).all(), name


def test_copies_stand_in_a_line_and_keep_the_covariance_together():
    for copies in (1, 2, 7):
        one = random_splats(1)
        one.opacities[:] = -5.0  # so faint that nothing shrinks for what overlaps
        params, _ = refined(one, copies + 1)
        along = (params["means"] - one.means) @ rotation_matrices(one.quats)[0]
        variances, long = (2 * one.scales[0]).exp(), one.scales[0].argmax()
        assert along.mean(dim=0).abs().max() < 1e-5 * variances.max().sqrt()
        together = along.var(dim=0, unbiased=False) + (2 * params["scales"]).exp().mean(dim=0)
        torch.testing.assert_close(together, variances, rtol=0.02, atol=0)
        assert (along[:, long].sort().values.diff() > 0.5 * variances[long].sqrt() / copies).all()


def test_copies_of_an_opaque_gaussian_are_not_more_opaque():
    one = random_splats(1)
    one.opacities[:] = 3.0
    params, _ = refined(one, 2)
    assert (params["opacities"] < 3.001).all() and (params["opacities"] > 2.0).all()


def test_neighbours_lie_together_in_memory():
    splats = random_splats(500)
    params, _ = refined(splats, 900)
    apart = [m.diff(dim=0).norm(dim=1).mean() for m in (splats.means, params["means"])]
    assert apart[1] < 0.4 * apart[0]


def test_gaussians_that_ran_away_move_to_living_ones():
    splats = random_splats(50)
    splats.means[:4], splats.opacities[4:6] = 1e12, torch.nan
    splats.scales[6], splats.quats[7] = 50.0, 0.0
    params, moments = refined(splats, 50)
    rows = rows_of(params, splats)
    assert (rows >= 8).all() and all(params[name].isfinite().all() for name in NAMES)
    assert not moments.second["means"][are_copied(rows)].any()


def test_dead_gaussians_move_to_living_ones():
    splats = random_splats(50)
    splats.opacities[:10] = -9.0
    params, moments = refined(splats, 50)
    assert (torch.sigmoid(params["opacities"]) > DEAD_OPACITY * 0.99).all()
    rows = rows_of(params, splats)
    assert (rows >= 10).all() and not moments.second["means"][are_copied(rows)].any()
    for count in (40, 30):  # fewer than there are removes none
        params, moments = refined(splats[10:], count)
        assert len(params["means"]) == 40


def test_what_no_photo_shows_is_left_out(said: list[str]):
    splats, cameras = random_splats(50), two_cameras()
    splats.opacities[:10] = -9.0
    kept = without_hidden(splats, cameras)
    faded = (kept.means[:, None] == splats.means[None, :10]).all(dim=-1)
    assert not faded.any() and 10 < len(kept) <= 40
    assert said == [f"Left out, as no photo shows them: {50 - len(kept)} Gaussians."]
    before, after = (rasterize(each, cameras)[0] for each in (splats, kept))
    torch.testing.assert_close(before, after, atol=0.02, rtol=0)
    assert len(without_hidden(kept, cameras)) == len(kept)


def test_refining_keeps_what_a_scene_looks_like():
    # Half of the Gaussians are dead, and the number doubles, so nearly all that show are copied.
    splats = random_splats(60, sh_degree=0)
    splats.opacities[30:] = -9.0
    splats.opacities[:30] = splats.opacities[:30].clamp(max=1.0)
    params, _ = refined(splats, 120)
    scenes = (splats, replace(splats, **params), splats[rows_of(params, splats)])
    before, after, unshrunk = (rasterize(scene, two_cameras())[0] for scene in scenes)
    # What a Gaussian contributes in all is kept within 6% here, its profile within 9.4%.
    error, unshrunk_error = (before - after).abs().mean(), (before - unshrunk).abs().mean()
    assert abs(after.mean() - before.mean()) < 0.08 * before.mean()
    assert error < 0.1 * before.mean()
    assert error < 0.35 * unshrunk_error


def test_copies_are_as_opaque_together_as_one_was():
    opacities, scales = torch.sigmoid(randn(200)), randn(200, 3).exp()
    copies = torch.arange(200) % MAX_COPIES + 1
    new, smaller = relocate(opacities, scales, copies)
    torch.testing.assert_close(1 - (1 - new) ** copies, opacities, atol=1e-4, rtol=0)
    alone = copies == 1
    torch.testing.assert_close(smaller[alone], scales[alone], atol=0, rtol=1e-5)
    # Equation 9 term by term
    for row in (1, 5, 40):
        total = sum(
            math.comb(i - 1, k) * (-1) ** k / (k + 1) ** 0.5 * float(new[row]) ** (k + 1)
            for i in range(1, int(copies[row]) + 1)
            for k in range(i)
        )
        expected = scales[row] * float(opacities[row]) / total
        torch.testing.assert_close(smaller[row], expected, atol=0, rtol=2e-3)


def test_noise_follows_the_covariance_of_faint_gaussians():
    # 20,000 equal Gaussians: the sample covariance is within a few percent of Sigma Sigma.
    one = random_splats(1, seed=4)
    one.opacities[:] = -20.0
    params = {n: t.repeat(20_000, *[1] * (t.ndim - 1)) for n, t in one.tensors().items()}
    before = params["means"].clone()
    params["opacities"][-5000:] = 3.0
    perturb_means(params, 1.0, 1.0, randn(20_000, 3))
    moved = (params["means"] - before)[:-5000]
    axes = rotation_matrices(one.quats)[0] * one.scales[0].exp()
    sigma = axes @ axes.T
    gate = torch.sigmoid(torch.tensor(NOISE_SHARPNESS * DEAD_OPACITY))
    expected = (NOISE_RATE * gate) ** 2 * sigma @ sigma
    assert (moved.T.cov() - expected).norm() < 0.05 * expected.norm()
    assert torch.equal(params["means"][-5000:], before[-5000:]), "opaque ones stay"


def test_both_devices_add_the_same_noise(monkeypatch: pytest.MonkeyPatch):
    emulated_cuda.install(monkeypatch)
    splats, noise = random_splats(300), randn(300, 3)
    splats.opacities.sub_(5)
    one, other = ({n: t.clone() for n, t in splats.tensors().items()} for _ in range(2))
    add_noise_cpu(one, noise, 100.0)
    add_noise_cuda(other, noise, 100.0)
    torch.testing.assert_close(one["means"], other["means"], atol=1e-4, rtol=1e-4)
    assert (one["means"] - splats.means).abs().max() > 0.1


def test_noise_and_regularizer_do_not_depend_on_the_unit_of_length():
    def learned(factor: float) -> tuple[torch.Tensor, torch.Tensor]:
        params = {name: t.clone() for name, t in random_splats(40).tensors().items()}
        params["opacities"][:] = -6.0
        params["means"] *= factor
        params["scales"] += math.log(factor)
        perturb_means(params, factor, 1.0, randn(40, 3))
        return params["means"] / factor, regularizer(params, factor)

    for one, other in zip(learned(1.0), learned(100.0), strict=True):
        assert torch.allclose(one, other, rtol=1e-4)


def test_objects_are_preferred():
    preference = growth_preference(SPLATS, 4.0)
    assert preference is not None
    assert (preference[OBJECTS] > 3.9).all() and (preference[~OBJECTS] < 1.1).all()
    few = torch.where(torch.arange(50) < 10, 1.0, 0.0)
    params, _ = refined(random_splats(50), 80, preference=few)
    assert torch.bincount(rows_of(params, random_splats(50)))[10:].max() == 1, (
        "the others are alone"
    )
    assert growth_preference(replace(SPLATS, identities=None), 4.0) is None


def test_copies_go_where_gradients_are_large():
    splats, grad = random_splats(50), torch.zeros(50, 3)
    grad[:10] = 1e-6
    for given, share in ((grad, 0.6), (torch.zeros(50, 3), 0.0)):
        remembered = dict[str, torch.Tensor]()
        add_gradients(remembered, given, torch.ones(50, dtype=torch.bool))
        params, _ = refined(splats, 150, take_scores(remembered, splats.tensors()))
        copies = torch.bincount(rows_of(params, splats), minlength=50) - 1
        assert copies[:10].sum() > share * 100 and not remembered
    assert (copies > 0).sum() > 20, "there were no gradients"


def test_scores_are_of_photos_that_show_a_gaussian_and_do_not_depend_on_the_unit_of_length():
    def scores(factor: float) -> torch.Tensor:
        params, remembered = random_splats(40).tensors(), dict[str, torch.Tensor]()
        params["scales"] = params["scales"] + math.log(factor)
        grad = randn(40, 3, seed=1) / factor
        grad[3] = math.nan
        add_gradients(remembered, grad, torch.ones(40, dtype=torch.bool))
        shown = torch.arange(40) < 20
        for _ in range(2):
            add_gradients(remembered, -grad * shown[:, None], shown)  # to and fro
        return take_scores(remembered, params)

    expected = random_splats(40).scales.mean(dim=1).exp() * randn(40, 3, seed=1).norm(dim=1)
    expected[3] = 0.0
    torch.testing.assert_close(scores(1.0), (expected / expected.mean() + LEAST_CHANGE).sqrt())
    torch.testing.assert_close(scores(1.0), scores(100.0))
