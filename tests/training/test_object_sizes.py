from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.training.object_sizes import growth_preference, limit_sizes, object_share

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


def test_a_preference_of_one_is_none():
    preference = growth_preference(SPLATS, 1.0)
    assert preference is not None and torch.allclose(preference, torch.ones(len(SPLATS)))
    assert growth_preference(replace(SPLATS, identities=None), 4.0) is None


def test_preference_grows_with_the_share():
    share, preference = object_share(SPLATS), growth_preference(SPLATS, 4.0)
    assert share is not None and preference is not None
    assert torch.equal(share.argsort(stable=True), preference.argsort(stable=True))
    assert preference.min() >= 1 and preference.max() <= 4


def test_limits_scale_with_the_pixels():
    limits = []
    for pixels in (1.0, 2.0):
        splats = replace(SPLATS, scales=torch.full_like(SPLATS.scales, 3.0))
        limit_sizes(splats, CAMERAS, pixels)
        limits.append(splats.scales[200].exp())
    assert torch.allclose(2 * limits[0], limits[1], rtol=1e-5)


def test_limits_shrink_with_the_size_of_the_photos():
    limits = []
    for cameras in (CAMERAS, CAMERAS.downscale(2)):
        splats = replace(SPLATS, scales=torch.full_like(SPLATS.scales, 3.0))
        limit_sizes(splats, cameras, 2.0)
        limits.append(splats.scales[200].exp())
    assert torch.allclose(2 * limits[0], limits[1], rtol=1e-5)


def test_limits_twice_are_limits_once():
    splats = replace(SPLATS, scales=torch.full_like(SPLATS.scales, 3.0))
    limit_sizes(splats, CAMERAS, 2.0)
    once = splats.scales.clone()
    limit_sizes(splats, CAMERAS, 2.0)
    assert torch.equal(splats.scales, once)


def test_without_objects_nothing_shrinks():
    for splats in (replace(SPLATS, identities=None), SPLATS[~OBJECTS]):
        large = replace(splats, scales=torch.full_like(splats.scales, 3.0))
        limit_sizes(large, CAMERAS, 2.0)
        assert (large.scales == 3).all()
