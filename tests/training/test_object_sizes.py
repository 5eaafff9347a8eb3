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
