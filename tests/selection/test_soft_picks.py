import math
from dataclasses import replace

import pytest
import torch

from balls import BALLS, CAMERAS, SPLATS, enlarged
from balls import RED as BALL
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.weights import coverage
from stylesplat.scene.splats import Splats
from stylesplat.selection import shares as surveying
from stylesplat.selection.labels import each_object
from stylesplat.selection.shares import (
    SHARE_INSIDE,
    SHARE_OUTSIDE,
    OwnShares,
    object_shares,
    small_views,
    survey,
)

VIEWS = enlarged(CAMERAS, 4)


def solid_ball(*, haze: bool) -> Splats:
    """1500 small Gaussians within a ball of radius 0.3, the first perhaps large and faint."""
    generator = torch.Generator().manual_seed(0)
    dirs = torch.nn.functional.normalize(torch.randn(1500, 3, generator=generator), dim=1)
    means = 0.3 * dirs * torch.rand(1500, 1, generator=generator) ** (1 / 3)
    splats = SPLATS[torch.full((1500,), 210)]
    scales = torch.full_like(splats.scales, math.log(0.02))
    opacities = splats.opacities.clone()
    if haze:
        means[0] = 0.0
        scales[0], opacities[0] = math.log(0.5), -2.0
    return replace(splats, means=means, scales=scales, opacities=opacities)


def test_shares_are_what_renders_say():
    """The weight of a Gaussian is the change of a render with its own colour."""
    shares = object_shares(SPLATS, BALL, VIEWS)
    row = int(((shares > 0.1) & (shares < 0.9)).nonzero()[0])
    lit = replace(SPLATS, sh0=SPLATS.sh0.index_add(0, torch.tensor([row]), torch.ones(1, 1, 3)))
    inside = everywhere = 0.0
    for camera in small_views(VIEWS):
        one, other = (rasterize(splats, camera)[0][0, ..., 2] for splats in (lit, SPLATS))
        inside += float((one - other)[coverage(SPLATS, camera, BALL) > 0.5].sum())
        everywhere += float((one - other).sum())
    expected = (inside / everywhere - SHARE_OUTSIDE) / (SHARE_INSIDE - SHARE_OUTSIDE)
    assert float(shares[row]) == pytest.approx(expected, abs=0.03)  # float16 weights
    assert not shares[~BALL].any()


def test_haze_is_not_the_object_and_what_is_well_inside_is():
    splats = solid_ball(haze=True)
    shares = object_shares(splats, torch.ones(len(splats), dtype=torch.bool), VIEWS)
    radius = splats.means.norm(dim=1)
    assert shares[0] == 0
    assert (shares[(radius < 0.2) & (radius > 0)] == 1).float().mean() > 0.95
    straddling = shares[radius > 0.29]
    assert straddling.mean() < 0.95 and ((straddling > 0) & (straddling < 1)).any()
    assert ((shares >= 0) & (shares <= 1)).all()


def test_what_no_view_shows_takes_after_its_neighbours():
    splats = solid_ball(haze=False)
    faint = replace(splats, opacities=splats.opacities.index_fill(0, torch.tensor([0]), -20.0))
    shares = object_shares(faint, torch.ones(len(splats), dtype=torch.bool), VIEWS)
    nearest = (splats.means - splats.means[0]).norm(dim=1).argsort()[1:10]
    torch.testing.assert_close(shares[0], shares[nearest].median())
    assert not object_shares(faint, torch.arange(len(splats)) == 0, VIEWS).any()


def test_shares_in_a_large_scene_are_those_in_the_whole(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(surveying, "VISIBLE_LARGE", 0)
    found = OwnShares(SPLATS, CAMERAS)
    for _, picked in each_object(SPLATS, [*BALLS]):
        assert torch.equal(found.of(picked), object_shares(SPLATS, picked, CAMERAS))
    nobody = torch.zeros(len(SPLATS), dtype=torch.bool)
    assert not found.of(nobody).any()
    means = SPLATS.means.clone()
    means[:50, 2] += 1e4  # of the table: neither near nor visible
    scene = replace(SPLATS, means=means)
    seen = survey(scene, small_views(CAMERAS))
    assert seen is not None
    for _, picked in each_object(scene, [*BALLS]):
        rows = seen.around(picked)
        assert torch.isin(picked.nonzero()[:, 0], rows).all() and (rows.diff() > 0).all()
        assert (rows >= 50).all()
