"""The weights of Gaussians in pixels are linear maps: `composite`, and its adjoint."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from scipy.sparse import csr_array
from torch import Tensor

from balls import BALLS, CAMERAS, PLAIN, SPLATS
from scenes import BACKENDS, cloud, device_of, leaf, rand, randn, random_splats, two_cameras
from stylesplat.rendering import weights
from stylesplat.rendering.render import Backend, colors_of, rasterize
from stylesplat.rendering.visibility import in_view, tiled
from stylesplat.rendering.weights import (
    Contributions,
    StoredContributions,
    backproject,
    colors_and_coverage,
    composite,
    contributions,
    coverage,
    expected_depth,
    label_pixels,
    pixels_in,
    render_argmax,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import SH_C0, Splats
from stylesplat.selection.labels import render_labels

ANY = ["reference", *BACKENDS]
CLOUD, TWO = random_splats(), two_cameras()
CAMERA = TWO[1]
TRUTH = [render_labels(SPLATS, CAMERAS[row]) for row in range(len(CAMERAS))]
PICKED = torch.arange(len(PLAIN)) % 3 == 0
ROUNDING = 1e-4  # float32 sums of the same weights in another order


def on(backend: Backend, *tensors: Splats | Tensor) -> list[Any]:
    """On the backend's device."""
    device = device_of(backend)
    return [each.to(device) for each in tensors]


def assert_near(found: Tensor, expected: Tensor, near: float = ROUNDING) -> None:
    """Relative to the norm."""
    assert found.shape == expected.shape
    assert (found.cpu() - expected.cpu()).norm() <= near * expected.norm()


@pytest.mark.parametrize("backend", ANY)
@pytest.mark.parametrize("count", [1, 3, 4, 16, 20])
def test_pixels_in_is_the_adjoint_of_composite(backend: Backend, count: int):
    splats, values, image = on(backend, CLOUD, randn(len(CLOUD), count), randn(52, 70, count))
    shown = composite(splats, CAMERA, values, backend=backend)
    sums = pixels_in(splats, CAMERA, [image], backend=backend)
    assert shown.shape == (52, 70, count) and sums.shape == (len(CLOUD), count)
    by_pixels, by_gaussians = (shown * image).sum(), (sums * values).sum()
    scale = float(shown.norm() * image.norm())
    assert float(by_gaussians) == pytest.approx(float(by_pixels), abs=1e-5 * scale)
    # CUDA adds in any order
    near = ROUNDING if backend in ("cuda", "gsplat") else 0
    assert_near(backproject(splats, CAMERA, image, backend=backend), sums, near)


@pytest.mark.parametrize("backend", ANY)
def test_pixels_add_up_over_views_and_over_disjoint_masks(backend: Backend):
    (splats,) = on(backend, CLOUD)
    masks = [rand(52, 70, seed=seed) > 0.5 for seed in range(2)]
    views = [pixels_in(splats, TWO[row], [masks[row]], backend=backend) for row in range(2)]
    together = pixels_in(splats, TWO, masks, backend=backend)
    assert together.shape == (len(CLOUD),) and together.any()
    assert_near(together, views[0] + views[1])
    both = pixels_in(splats, TWO, [torch.stack([each, ~each], -1) for each in masks])
    every = pixels_in(splats, TWO, [torch.ones(52, 70)] * 2, backend=backend)
    assert_near(both.sum(dim=1), every)
    covered = sum(coverage(splats, camera).sum() for camera in TWO)
    assert float(every.sum()) == pytest.approx(float(covered), rel=ROUNDING)


@pytest.mark.parametrize("backend", ANY)
def test_shuffling_the_gaussians_permutes_the_rows(backend: Backend):
    order = torch.randperm(len(CLOUD), generator=torch.Generator().manual_seed(5))
    splats, shuffled, masks = on(backend, CLOUD, CLOUD[order], rand(52, 70, 3))
    sums = pixels_in(splats, CAMERA, [masks], backend=backend).cpu()
    assert_near(pixels_in(shuffled, CAMERA, [masks], backend=backend), sums[order])


@pytest.mark.parametrize("backend", BACKENDS)
def test_weights_are_the_references(backend: Backend):
    exact = leaf(CLOUD, torch.float64)
    splats, values, image = on(backend, CLOUD, randn(len(CLOUD), 5), randn(52, 70, 5))
    expected = composite(exact, CAMERA, values.cpu().double(), backend="reference")
    assert_near(composite(splats, CAMERA, values, backend=backend), expected)
    expected = backproject(exact, CAMERA, image.cpu().double(), backend="reference")
    assert_near(backproject(splats, CAMERA, image, backend=backend), expected)


def test_of_wanted_pixels_others_need_not_be_right():
    pixels, values = torch.zeros(52, 70, dtype=torch.bool), randn(len(CLOUD), 2)
    pixels[:10, :20] = True
    part, whole = (composite(CLOUD, CAMERA, values, wanted) for wanted in (pixels, None))
    assert torch.equal(part[pixels], whole[pixels])


def squares(side: int) -> list[Tensor]:
    """12, 48 or 192 squares in a view that move from view to view, before a background."""
    rows, columns = torch.meshgrid(torch.arange(36), torch.arange(48), indexing="ij")
    labels = 1 + rows // side * (48 // side) + columns // side
    labels[:, 20:23] = 0
    labels[30:, 40:] = weights.NOBODY
    return [labels.roll(5 * view, dims=1) + 1000 * (view % 2) * (labels > 0) for view in range(4)]


@pytest.mark.parametrize("maps", [TRUTH, squares(12), squares(6), squares(3)], ids=len)
def test_label_pixels_are_the_pixels_in_masks(maps: list[Tensor]):
    ids, found = label_pixels(PLAIN, CAMERAS, enumerate(maps))
    assert ids == tuple(sorted({0, *torch.cat(maps).unique().tolist()} - {weights.NOBODY}))
    masks = [labels[..., None] == torch.tensor(ids) for labels in maps]
    expected = pixels_in(PLAIN, CAMERAS[: len(maps)], masks)
    assert_near(torch.from_numpy(found.toarray()), expected)
    assert found.nnz == (expected > 0).sum()


def test_of_objects_label_pixels_are_those_that_show_them():
    ids, found = label_pixels(PLAIN, CAMERAS, enumerate(TRUTH))
    assert ids == (0, *BALLS)
    alphas = sum(float(coverage(PLAIN, camera).sum()) for camera in CAMERAS)
    assert float(found.sum()) == pytest.approx(alphas, rel=1e-4)


def test_the_argmax_is_that_of_all_values():
    values = rand(len(PLAIN), 40)
    values *= values > 0.8
    most, column = render_argmax(PLAIN, CAMERAS[1], csr_array(values.numpy()))
    expected = composite(PLAIN, CAMERAS[1], values).max(dim=-1)
    assert torch.equal(most, expected.values)
    covered = most > 0  # where nothing shows no column is larger than another
    assert torch.equal(column[covered], expected.indices[covered]) and column.max() >= 32


@pytest.mark.parametrize("row", range(2))
def test_in_a_large_scene_an_object_is_looked_for_where_it_may_show(
    row: int, monkeypatch: pytest.MonkeyPatch
):
    few = PICKED & (torch.arange(len(PLAIN)) < len(PLAIN) // 8)
    nobody = torch.zeros_like(few)
    whole = coverage(PLAIN, CAMERAS[row], few)
    monkeypatch.setattr(weights, "VISIBLE_LARGE", 0)
    assert torch.equal(coverage(PLAIN, CAMERAS[row], few), whole) and whole.any()
    assert not coverage(PLAIN, CAMERAS[row], nobody).any()


def test_colors_come_with_their_coverage():
    image, share = colors_and_coverage(PLAIN, CAMERAS[0], PICKED)
    assert torch.equal(share[..., 0], coverage(PLAIN, CAMERAS[0], PICKED))
    plain = rasterize(PLAIN, CAMERAS[0])[0][0]
    torch.testing.assert_close(image, plain, atol=ROUNDING, rtol=0)


def wall(depth: float) -> tuple[Splats, Cameras]:
    """A dense wall of opaque Gaussians across the right half of a camera's view."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, 40), torch.linspace(0.1, 1, 20), indexing="ij")
    means = depth * torch.stack([x, y, torch.ones_like(x)], dim=-1).reshape(-1, 3)
    camera = replace(CAMERAS[0], viewmats=torch.eye(4)[None])
    return cloud(means, 0.05 * depth, opacity=6.0), camera


@pytest.mark.parametrize("depth", [0.5, 3.0, 40.0])
def test_the_expected_depth_of_a_wall_is_where_it_stands(depth: float):
    splats, camera = wall(depth)
    found, alphas = expected_depth(splats, camera)
    covered = alphas > 0.5
    assert 0.2 < covered.float().mean() < 0.8
    # the depth is an average of equal numbers: rounding
    assert (found[covered] - depth).abs().max() < 1e-4 * depth
    assert not found[alphas == 0].any() and (alphas == 0).any()


# One image as a function of the colours of some Gaussians. Stored weights are float16: 11 bits, an
# error of 0.0005 each. A lost entry shows more.
HALVES = 1e-3
HALF = torch.arange(len(CLOUD)) % 2 == 0  # every other one, so that each part hides the other
CHOICES = {
    "half": HALF,
    "few": torch.arange(len(CLOUD)) < 3,
    "none": torch.zeros_like(HALF),
    "all": torch.ones_like(HALF),
    "out of view": HALF,
    "antialiased": HALF,
}
View = Callable[..., Contributions]


@pytest.fixture(params=[True, False], ids=["stored", "tiled"])
def view(request: pytest.FixtureRequest) -> View:
    """The contributions of some Gaussians to the second view, with or without stored weights."""

    def make(splats: Splats = CLOUD, mask: Tensor = HALF) -> Contributions:
        most = torch.inf if request.param else -1.0
        found = contributions(splats, CAMERA, mask, max_bytes=most)
        assert isinstance(found, StoredContributions) == request.param
        return found

    return make


def own_colors(found: Contributions, splats: Splats = CLOUD) -> Tensor:
    return colors_of(splats, found.gaussians, CAMERA.positions)


def reference(splats: Splats, mask: Tensor) -> tuple[Tensor, Tensor]:
    """The image, and the opaque share of some Gaussians."""
    features = mask[:, None].to(splats.means)
    image, _, _ = rasterize(splats, CAMERA, features=features, backend="reference")
    return image[0, ..., :3], image[0, ..., 3]


@pytest.mark.parametrize("name", CHOICES)
def test_image_and_coverage_match_the_reference(name: str, view: View):
    mask = CHOICES[name]
    splats = replace(CLOUD, means=CLOUD.means + 500) if name == "out of view" else CLOUD
    if name == "antialiased":
        splats = replace(splats, scales=splats.scales - 2, antialiased=True)
    found = view(splats, mask)
    image, covered = reference(leaf(splats, torch.float64), mask)
    shown = found.render(own_colors(found, splats))
    torch.testing.assert_close(shown.double(), image.detach(), atol=HALVES, rtol=0)
    assert (found.coverage - covered.detach()).abs().max() < HALVES
    assert mask[found.gaussians].all()
    assert found.gaussians.unique().shape == found.gaussians.shape
    assert (name in ("none", "out of view")) == (len(found.gaussians) == 0)


def test_the_picked_and_the_others_make_the_whole(view: View):
    half, others = view(), view(mask=~HALF)
    both = half.coverage + others.coverage
    alphas = rasterize(CLOUD, CAMERA)[1][0, ..., 0]
    assert (both - alphas).abs().max() < 1e-5  # float32 sums of the same weights
    assert half.coverage.min() >= 0 and half.coverage.max() <= 1
    image = half.background + others.background
    # each background lacks just what the other holds
    assert (image - rasterize(CLOUD, CAMERA)[0][0]).abs().max() < 1e-4


def test_gradients_match_the_reference(view: View):
    sizes = randn(52, 70, 3, seed=3)
    expected, found, half = leaf(CLOUD, torch.float64), leaf(CLOUD, torch.float32), view()
    image, _ = reference(expected, HALF)
    (image * sizes.double()).sum().backward()
    (half.render(own_colors(half, found)) * sizes).sum().backward()
    for name in ("sh0", "shN"):
        wanted, gradient = (s.tensors()[name].grad for s in (expected, found))
        assert wanted is not None and gradient is not None
        assert_near(gradient[HALF], wanted[HALF], HALVES)
        assert not gradient[~HALF].any()


@pytest.mark.parametrize("count", [1, 3, 5])
def test_contributions_are_those_of_the_scene(view: View, count: int):
    half, values, image = view(), randn(len(CLOUD), count), randn(52, 70, count)
    expected = composite(CLOUD, CAMERA, values * HALF[:, None])
    shown = half.composite(values[half.gaussians])
    assert_near(shown, expected, HALVES)
    sums = backproject(CLOUD, CAMERA, image)
    assert_near(half.backproject(image), sums[half.gaussians], HALVES)
    by_pixels, by_gaussians = shown * image, half.backproject(image) * values[half.gaussians]
    near = 1e-5 * float(shown.norm() * image.norm())
    assert float(by_gaussians.sum()) == pytest.approx(float(by_pixels.sum()), abs=near)
    masks = torch.stack([image[..., 0] > 0, torch.ones(52, 70).bool()], dim=-1)
    inside, everywhere = half.pixels_in(masks).unbind(dim=1)
    assert_near(inside, pixels_in(CLOUD, CAMERA, [masks[..., 0]]) * HALF, HALVES)
    assert torch.equal(half.pixels_in(masks[..., 1]), everywhere)
    assert float(everywhere.sum()) == pytest.approx(float(half.coverage.sum()), rel=HALVES)
    assert not half.pixels_in(torch.zeros(52, 70)).any()


def test_weights_that_take_too_much_are_not_stored():
    half = contributions(CLOUD, CAMERA, HALF)
    assert isinstance(half, StoredContributions) and half.nbytes > 0
    for most, is_stored in ((1.0, True), (0.1, False)):
        found = contributions(CLOUD, CAMERA, HALF, max_bytes=most * half.nbytes)
        assert isinstance(found, StoredContributions) == is_stored == (found.nbytes == half.nbytes)
        assert found.nbytes > found.background.nbytes + found.coverage.nbytes


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_is_kept_of_a_view_counts(backend: Backend):
    (splats,) = on(backend, CLOUD)
    near = in_view(splats, CAMERA, backend=backend)
    kept = tiled(near.projected, CAMERA.size, backend).nbytes
    assert kept >= near.projected.means2d.nbytes + near.projected.conics.nbytes


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_colors_below_black_are_kept_where_they_are_wanted(backend: Backend):
    dark = replace(CLOUD, sh0=CLOUD.sh0 * 0 - 5.0, shN=CLOUD.shN * 0)
    image, alphas, _ = rasterize(dark, CAMERA, clamp=False, backend=backend)
    torch.testing.assert_close(
        image, alphas * (0.5 - 5.0 * SH_C0) * torch.ones(3), atol=1e-5, rtol=0
    )
    assert not rasterize(dark, CAMERA, backend=backend)[0].any()
