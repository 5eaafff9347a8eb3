import math
from dataclasses import replace

import pytest
import torch

from balls import BALLS, CAMERAS, SPLATS, enlarged
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.shares import coverage
from stylesplat.scene.splats import Splats
from stylesplat.selection import soft_picks as surveying
from stylesplat.selection.pick import each_object
from stylesplat.selection.soft_picks import (
    OwnShares,
    find_places,
    inside_parts,
    own_shares,
    sampled_views,
    soft_shares,
    survey,
)

VIEWS = enlarged(CAMERAS, 4)
BALL = (torch.arange(len(SPLATS)) >= 200) & (torch.arange(len(SPLATS)) < 280)


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


def test_an_object_is_where_it_covers_most():
    for place in find_places(SPLATS, BALL, VIEWS):
        row = VIEWS.index(place.camera.names[0])
        assert torch.equal(place.pixels, coverage(SPLATS, VIEWS[row], BALL) > 0.5)


def test_parts_are_what_the_weights_say():
    """Of one Gaussian, whose weights are the change of a render with its own colour."""
    places = find_places(SPLATS, BALL, VIEWS)
    parts = inside_parts(SPLATS, BALL, places)
    row = 215
    lit = replace(SPLATS, sh0=SPLATS.sh0.index_add(0, torch.tensor([row]), torch.ones(1, 1, 3)))
    inside = everywhere = 0.0
    for place in places:
        one, other = (rasterize(s, place.camera)[0][0, ..., 2] for s in (lit, SPLATS))
        inside += float((one - other)[place.pixels].sum())
        everywhere += float((one - other).sum())
    assert float(parts[row]) == pytest.approx(inside / everywhere, rel=1e-2)  # float16 weights
    assert not parts[~BALL].any()


def test_haze_is_not_the_object_and_what_is_well_inside_is():
    splats = solid_ball(haze=True)
    everything = torch.ones(len(splats), dtype=torch.bool)
    shares = soft_shares(splats, everything, find_places(splats, everything, VIEWS))
    radius = splats.means.norm(dim=1)
    assert shares[0] == 0
    assert (shares[(radius < 0.2) & (radius > 0)] == 1).float().mean() > 0.95
    straddling = shares[radius > 0.29]
    assert straddling.mean() < 0.95 and ((straddling > 0) & (straddling < 1)).any()
    assert ((shares >= 0) & (shares <= 1)).all()


def test_what_no_view_shows_takes_after_its_neighbours():
    splats = solid_ball(haze=False)
    faint = replace(splats, opacities=splats.opacities.index_fill(0, torch.tensor([0]), -20.0))
    everything = torch.ones(len(splats), dtype=torch.bool)
    places = find_places(faint, everything, VIEWS)
    parts = inside_parts(faint, everything, places)
    distances = (splats.means - splats.means[0]).norm(dim=1)
    seen = parts.gather(0, distances.argsort()[1:10])
    torch.testing.assert_close(parts[0], seen.median())
    alone = torch.arange(len(splats)) == 0
    assert not inside_parts(faint, alone, places).any()


@pytest.fixture
def large(monkeypatch: pytest.MonkeyPatch) -> None:
    """The balls' scene counts as large."""
    monkeypatch.setattr(surveying, "LARGE", 0)


@pytest.mark.usefixtures("large")
def test_shares_are_those_in_the_whole_scene():
    found = OwnShares(SPLATS, CAMERAS)
    for _, picked in each_object(SPLATS, [*BALLS]):
        assert torch.equal(found.of(picked), own_shares(SPLATS, picked, CAMERAS))
    nobody = torch.zeros(len(SPLATS), dtype=torch.bool)
    assert not found.of(nobody).any()


@pytest.mark.usefixtures("large")
def test_what_is_not_near_and_does_not_show_is_left_out():
    means = SPLATS.means.clone()
    means[:50, 2] += 1e4  # of the table
    scene = replace(SPLATS, means=means)
    seen = survey(scene, sampled_views(CAMERAS))
    assert seen is not None
    for _, picked in each_object(scene, [*BALLS]):
        rows = seen.around(picked)
        assert torch.isin(picked.nonzero()[:, 0], rows).all() and (rows.diff() > 0).all()
        assert (rows >= 50).all()
