"""Split scenes look like those before, and nothing but the object is split."""

import math
from dataclasses import replace

import pytest
import torch

from balls import CAMERAS
from stretched_balls import BALL, LARGE, PICKED, ROWS, SCENE, TABLE, UNSEEN, stretched
from stylesplat.rendering.linear import contributions
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.shares import coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.object_views import ObjectView, cut_views, find_boxes
from stylesplat.stylization.overflow import without_overflow
from stylesplat.stylization.split import COUNTS, Split, screen_sizes, split_large

SHARPER = 3.0  # than the scene's cameras: so many pixels as there are strokes


def sharp_views(splats: Splats, network: FeatureNetwork) -> list[ObjectView]:
    boxes = find_boxes(splats, CAMERAS, PICKED)
    cells = [network.cells(2)]
    return cut_views(splats, boxes, PICKED, cells, zoom=SHARPER, max_memory=math.inf)


def divide(
    splats: Splats, network: FeatureNetwork, growth: float, cameras: Cameras = CAMERAS
) -> Split:
    views = sharp_views(splats, network)
    split = split_large(splats, PICKED, views, max_growth=growth)
    return without_overflow(splats, split, PICKED, cameras)


@pytest.fixture(scope="module")
def split(network: FeatureNetwork) -> Split:
    return divide(SCENE, network, 6.0)


def psnr(one: torch.Tensor, other: torch.Tensor) -> float:
    return float(-10 * (one - other).square().mean().log10())


def test_parents_are_the_rows_before_and_those_of_the_children_after(split: Split):
    count = len(SCENE)
    assert len(split.splats) == len(split.parents) > count + 100
    assert torch.equal(split.parents[:count], ROWS)
    assert PICKED[split.parents[count:]].all()


def test_only_the_picked_are_touched(split: Split):
    for name, before in SCENE.tensors().items():
        after = split.splats.tensors()[name]
        assert torch.equal(after[: len(SCENE)][~PICKED], before[~PICKED]), name
    assert split.splats.classifier is SCENE.classifier


def test_children_take_after_their_parents(split: Split):
    for name in ("sh0", "shN", "identities", "quats", "confidence"):
        inherited = SCENE.tensors()[name][split.parents]
        assert torch.equal(split.splats.tensors()[name], inherited), name
    parents = SCENE[split.parents]
    assert (split.splats.scales <= parents.scales).all()
    assert (split.splats.opacities <= parents.opacities + 1e-5).all()  # roundings of logits


def test_one_child_keeps_the_centre(split: Split):
    """To the bit: undoing a split puts only scales and opacities back."""
    assert torch.equal(split.splats.means[: len(SCENE)], SCENE.means)


def test_small_ones_are_not_split(split: Split):
    divided = split.parents[len(SCENE) :].unique()
    small = PICKED & (ROWS >= TABLE + LARGE)
    sizes = SCENE.scales.exp().amax(dim=1)
    assert sizes[divided].min() > 0.06
    for name in ("scales", "opacities"):
        before, after = SCENE.tensors()[name], split.splats.tensors()[name][: len(SCENE)]
        kept = torch.ones(len(SCENE), dtype=torch.bool).index_fill(0, divided, False)
        assert torch.equal(after[kept], before[kept]), name
    assert len(divided) < LARGE + small.sum()


def test_the_object_looks_finer_and_the_same(split: Split, network: FeatureNetwork):
    before = sharp_views(SCENE, network)
    picked = PICKED[split.parents]
    sizes, weights = screen_sizes(SCENE, before)
    after = [
        replace(view, linear=contributions(split.splats, view.camera, picked)) for view in before
    ]
    finer, finer_weights = screen_sizes(split.splats, after)
    longest = (sizes.amax(dim=1) * weights).sum() / weights.sum()
    # spilling ones stay large: half of this scene's, which are as large as the ball
    assert (finer.amax(dim=1) * finer_weights).sum() / finer_weights.sum() < 0.9 * longest
    pairs = zip(before, after, strict=True)
    errors = [psnr(view.render(SCENE), new.render(split.splats)) for view, new in pairs]
    # 42 to 44 dB: sums of Gaussians are their parent's shape to 1 %, but cover 1 - (1 - a)(1 - b)
    assert min(errors) > 38


@pytest.mark.parametrize("growth", [1.5, 2.0, 4.0])
def test_the_cap_holds(growth: float, network: FeatureNetwork):
    grown = divide(SCENE, network, growth)
    count = int(PICKED[grown.parents].sum())
    assert BALL < count <= growth * BALL


def test_the_cap_is_used_if_nothing_spills(network: FeatureNetwork):
    grown = divide(SCENE, network, 3.0, cameras=CAMERAS[:0])
    # children of one Gaussian come together, up to 100 of them
    assert 2 * BALL < int(PICKED[grown.parents].sum()) <= 3 * BALL


def test_no_room_splits_nothing(network: FeatureNetwork):
    same = divide(SCENE, network, 1.0)
    assert torch.equal(same.parents, ROWS)
    for name, before in SCENE.tensors().items():
        assert torch.equal(same.splats.tensors()[name], before)


@pytest.mark.parametrize("seed", range(6))
def test_nothing_shows_where_nothing_of_the_object_did(seed: int, network: FeatureNetwork):
    """Nor does anything else change there."""
    scene = stretched(seed=seed)
    fine = CAMERAS.downscale(1 / SHARPER)
    divided = divide(scene, network, 8.0, cameras=fine)
    assert len(divided.parents) > len(scene) + 50
    for index in range(len(fine)):
        camera = fine[index]
        outside = coverage(scene, camera, PICKED) == 0
        after = coverage(divided.splats, camera, PICKED[divided.parents])
        assert 0 < outside.sum() < outside.numel()
        assert after[outside].max() < UNSEEN
        images = [rasterize(s, camera)[0][0][outside] for s in (scene, divided.splats)]
        assert (images[0] - images[1]).abs().max() < 2 * UNSEEN  # of colours up to 2


def test_without_the_check_something_would_show(network: FeatureNetwork):
    """What the law above is worth: some Gaussians are large enough to break it."""
    scene = stretched(seed=1)
    fine = CAMERAS.downscale(1 / SHARPER)
    careless = divide(scene, network, 8.0, cameras=CAMERAS[:0])
    spilled = 0.0
    for index in range(len(fine)):
        outside = coverage(scene, fine[index], PICKED) == 0
        after = coverage(careless.splats, fine[index], PICKED[careless.parents])
        spilled = max(spilled, float(after[outside].max()))
    assert spilled > 100 * UNSEEN


def test_counts_are_odd_and_combine(split: Split):
    children = split.parents.bincount(minlength=len(SCENE))
    assert children.max() <= math.prod([max(COUNTS)] * 3)
    assert children[~PICKED].eq(1).all()
