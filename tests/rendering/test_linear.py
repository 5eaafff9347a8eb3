"""Linear rendering: the kept weights give the reference's image, and its gradients of colours."""

from dataclasses import replace

import pytest
import torch

from scenes import leaf, randn, random_splats, two_cameras
from stylesplat.rendering.linear import (
    Contributions,
    RasterizedContributions,
    contributions,
    linear_view,
)
from stylesplat.rendering.render import Backend, rasterize
from stylesplat.scene.splats import SH_C0, Splats

# Weights are kept as float16: 11 bits, an error of 0.0005 each. A lost entry shows more.
TOLERANCE = 1e-3
SPLATS = random_splats()
CAMERA = two_cameras()[1:]
HALF = torch.arange(len(SPLATS)) % 2 == 0  # every other one, so that each part hides the other
CHOICES = {
    "half": HALF,
    "few": torch.arange(len(SPLATS)) < 3,
    "none": torch.zeros_like(HALF),
    "all": torch.ones_like(HALF),
    "out of view": HALF,
    "antialiased": HALF,
}


def reference(splats: Splats, picked: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The image and the opaque share of the picked Gaussians."""
    image, _, _ = rasterize(
        splats, CAMERA, features=picked[:, None].to(splats.means), backend="reference"
    )
    return image[0, ..., :3], image[0, ..., 3]


@pytest.fixture(scope="module")
def half() -> Contributions:
    return contributions(SPLATS, CAMERA, HALF)


def relative_error(found: torch.Tensor, expected: torch.Tensor) -> float:
    return float((found.double() - expected).norm() / expected.norm())


@pytest.mark.parametrize("name", CHOICES)
def test_image_and_coverage_match_the_reference(name: str):
    picked = CHOICES[name]
    splats = replace(SPLATS, means=SPLATS.means + 500) if name == "out of view" else SPLATS
    if name == "antialiased":
        splats = replace(splats, scales=splats.scales - 2, antialiased=True)
    view = contributions(splats, CAMERA, picked)
    image, covered = reference(leaf(splats, torch.float64), picked)
    torch.testing.assert_close(view.render(splats).double(), image.detach(), atol=TOLERANCE, rtol=0)
    assert (view.coverage - covered.detach()).abs().max() < TOLERANCE
    assert picked[view.gaussians].all()
    assert view.gaussians.unique().shape == view.gaussians.shape == view.weights().shape
    assert (name in ("none", "out of view")) == (len(view.gaussians) == 0)
    changed = view.image(torch.zeros(len(view.gaussians), 3, requires_grad=True))
    assert changed.shape == view.background.shape


def test_the_picked_and_the_others_make_the_whole(half: Contributions):
    others = contributions(SPLATS, CAMERA, ~HALF)
    both = half.coverage + others.coverage
    alphas = rasterize(SPLATS, CAMERA)[1][0, ..., 0]
    assert (both - alphas).abs().max() < 1e-5  # float32 sums of the same weights
    assert half.coverage.min() >= 0 and half.coverage.max() <= 1
    image = half.background + others.background
    # each background lacks just what the other holds
    assert (image - rasterize(SPLATS, CAMERA)[0][0]).abs().max() < 1e-4


def test_gradients_match_the_reference(half: Contributions):
    weights = randn(*half.background.shape, seed=3)
    expected, found = leaf(SPLATS, torch.float64), leaf(SPLATS, torch.float32)
    image, _ = reference(expected, HALF)
    (image * weights.double()).sum().backward()
    (half.render(found) * weights).sum().backward()
    for name in ("sh0", "shN"):
        wanted, gradient = (s.tensors()[name].grad for s in (expected, found))
        assert wanted is not None
        assert gradient is not None
        assert relative_error(gradient[HALF], wanted[HALF]) < TOLERANCE, name
        assert not gradient[~HALF].any()


def test_weights_are_the_sums_over_pixels(half: Contributions):
    for number in (0, 7, len(half.gaussians) - 1):
        alone = torch.zeros(len(half.gaussians), 3)
        alone[number] = 1
        column = (half.image(alone) - half.background)[..., 0]
        rows = torch.arange(column.shape[0])[:, None]
        pixels = (rows < 30).expand_as(column)
        # differences of colours around 1 carry an error of 1e-7 per pixel, of 3640
        near = 1e-4 * float(column.sum()) + 2e-4
        assert float(half.weights()[number]) == pytest.approx(float(column.sum()), abs=near)
        above = float(column[pixels].sum())
        assert float(half.weights(pixels)[number]) == pytest.approx(above, abs=near)
    assert float(half.weights().sum()) == pytest.approx(float(half.coverage.sum()), rel=TOLERANCE)
    assert not half.weights(torch.zeros_like(half.coverage, dtype=torch.bool)).any()


def test_weights_that_would_not_fit_are_not_kept(half: Contributions):
    assert isinstance(linear_view(SPLATS, CAMERA, HALF), Contributions)
    view = linear_view(SPLATS, CAMERA, HALF, max_bytes=half.nbytes / 10)
    assert isinstance(view, RasterizedContributions)
    torch.testing.assert_close(view.coverage, half.coverage, atol=TOLERANCE, rtol=0)
    torch.testing.assert_close(view.render(SPLATS), half.render(SPLATS), atol=TOLERANCE, rtol=0)
    sums = torch.zeros(2, len(SPLATS))
    for row, each in enumerate((half, view)):
        sums[row, each.gaussians] = each.weights()
    assert relative_error(sums[1], sums[0].double()) < TOLERANCE


def test_matte_views_give_the_same_image(half: Contributions):
    fixed, matte = half.as_matte(), replace(SPLATS, shN=SPLATS.shN * ~HALF[:, None, None])
    brighter = replace(matte, sh0=SPLATS.sh0 + 0.3 * HALF[:, None, None])
    for splats in (matte, brighter):
        torch.testing.assert_close(fixed.render(splats), half.render(splats), atol=2e-6, rtol=0)
    weights = randn(*half.background.shape, seed=5)
    gradients = []
    for view in (half, fixed):
        splats = leaf(brighter, torch.float32)
        (view.render(splats) * weights).sum().backward()
        gradients.append(splats.sh0.grad)
    darker = replace(matte, sh0=SPLATS.sh0 - 4.0 * HALF[:, None, None])
    images = [view.render(darker, clamp=False) for view in (half, fixed)]
    assert images[0].min() < -0.5
    torch.testing.assert_close(images[0], images[1], atol=2e-6, rtol=0)  # float32
    assert relative_error(gradients[1], gradients[0].double()) < 1e-6


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_colors_below_black_are_kept_where_they_are_wanted(backend: Backend):
    dark = replace(SPLATS, sh0=SPLATS.sh0 * 0 - 5.0, shN=SPLATS.shN * 0)
    image, alphas, _ = rasterize(dark, CAMERA, clamp=False, backend=backend)
    torch.testing.assert_close(
        image, alphas * (0.5 - 5.0 * SH_C0) * torch.ones(3), atol=1e-5, rtol=0
    )
    assert not rasterize(dark, CAMERA, backend=backend)[0].any()
