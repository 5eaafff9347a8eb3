"""Fitted children look more like their parents, and nothing else is touched."""

import math
from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, enlarged
from stretched_balls import PICKED, ROWS, SCENE, UNSEEN
from stylesplat.metrics.psnr import psnr
from stylesplat.rendering.shares import COVERED, colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.object_views import Box, cut_views, find_boxes
from stylesplat.stylization.overflow import without_overflow
from stylesplat.stylization.refit import RATES, refit
from stylesplat.stylization.split import Split, split_large

FINE = enlarged(CAMERAS, 3)
SEEN, OTHERS = FINE[[0, 2, 4, 6]], FINE[[1, 3, 5, 7]]
GAINED = 2.5  # dB at least in the views that were looked at


@pytest.fixture(scope="module")
def boxes() -> list[Box]:
    return find_boxes(SCENE, FINE, PICKED)


@pytest.fixture(scope="module")
def split(network: FeatureNetwork, boxes: list[Box]) -> Split:
    views = cut_views(SCENE, boxes, PICKED, [network.cells(2)], zoom=1.0, max_memory=math.inf)
    return split_large(SCENE, PICKED, views, max_growth=6.0)


@pytest.fixture(scope="module")
def fitted(split: Split, boxes: list[Box]) -> Split:
    return refit(SCENE, split, PICKED, boxes)


def likeness(split: Split, cameras: Cameras) -> tuple[float, float]:
    """PSNR inside the object: of the colours, and of the object's coverage."""
    colors, covers = [], []
    for index in range(len(cameras)):
        before, cover = colors_and_coverage(SCENE, cameras[index], PICKED)
        after, covered = colors_and_coverage(split.splats, cameras[index], PICKED[split.parents])
        inside = cover[..., 0] > COVERED
        assert inside.sum() > 100
        colors.append(psnr(after[inside], before[inside]))
        covers.append(psnr(covered[inside], cover[inside]))
    return float(torch.stack(colors).mean()), float(torch.stack(covers).mean())


def test_the_object_looks_more_as_before(split: Split, fitted: Split):
    before, after = likeness(split, FINE), likeness(fitted, FINE)
    assert after[0] > before[0] + GAINED
    assert after[1] > before[1] + GAINED


def test_so_it_does_from_cameras_in_between(split: Split):
    """Even from the middle between four that look from each side."""
    fitted = refit(SCENE, split, PICKED, find_boxes(SCENE, SEEN, PICKED))
    before, after = likeness(split, OTHERS), likeness(fitted, OTHERS)
    assert after[0] > before[0] + 0.5
    assert after[1] > before[1] + 0.5


def test_only_opacities_and_scales_of_split_gaussians_change(split: Split, fitted: Split):
    assert torch.equal(fitted.parents, split.parents)
    divided = split.parents.bincount()[split.parents] > 1
    for name, before in split.splats.tensors().items():
        after = fitted.splats.tensors()[name]
        assert torch.equal(after[~divided], before[~divided]), name
        assert torch.equal(after, before) == (name not in RATES), name
        assert torch.isfinite(after).all(), name


def test_the_seed_gives_the_same_again_and_another_one_does_not(
    split: Split, fitted: Split, boxes: list[Box]
):
    again, other = (refit(SCENE, split, PICKED, boxes, seed=seed) for seed in (0, 1))
    for name in RATES:
        assert torch.equal(again.splats.tensors()[name], fitted.splats.tensors()[name])
        assert not torch.equal(other.splats.tensors()[name], fitted.splats.tensors()[name])


def test_without_children_there_is_nothing_to_fit(boxes: list[Box]):
    whole = Split(SCENE, ROWS)
    assert refit(SCENE, whole, PICKED, boxes) is whole


def test_what_grew_beyond_the_object_is_taken_back(split: Split):
    """All of a parent's children, to the bit; nothing else."""
    row = int(split.parents[-1])
    scales = split.splats.scales.clone()
    scales[-1] += math.log(8)
    swollen = replace(split, splats=replace(split.splats, scales=scales))
    tidy = without_overflow(SCENE, swollen, PICKED, FINE)
    assert (swollen.parents == row).sum() > 1
    assert (tidy.parents == row).sum() == 1
    for name, before in SCENE.tensors().items():
        assert torch.equal(tidy.splats.tensors()[name][row], before[row]), name
    careful = without_overflow(SCENE, split, PICKED, FINE)
    left = careful.parents != row
    assert torch.equal(tidy.parents[tidy.parents != row], careful.parents[left])


def test_fitted_children_stay_where_the_object_was(fitted: Split):
    tidy = without_overflow(SCENE, fitted, PICKED, FINE)
    assert len(SCENE) < len(tidy.parents) < len(fitted.parents)  # some of this scene's do spill
    for index in range(len(FINE)):
        _, before = colors_and_coverage(SCENE, FINE[index], PICKED)
        _, after = colors_and_coverage(tidy.splats, FINE[index], PICKED[tidy.parents])
        assert after[before == 0].max() < UNSEEN
