from dataclasses import replace
from typing import Any

import pytest
import torch

from balls import CAMERAS, FAST, ball, same
from balls import STRIPED_SCENE as SCENE
from stylesplat.stylization import painter as cutting
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.painter import crop_scene, paint_objects, paint_setup
from stylesplat.stylization.painting import Painting, PaintSetup

BALL = ball(0)
ELSEWHERE = 100  # Gaussians that no camera sees, before all others


@pytest.fixture
def studio(network: FeatureNetwork, monkeypatch: pytest.MonkeyPatch) -> PaintSetup:
    """A scene that counts as large, most of which is out of sight."""
    monkeypatch.setattr(cutting, "VISIBLE_LARGE", 0)
    away = SCENE[torch.arange(ELSEWHERE)]
    away = replace(away, means=away.means + torch.tensor([0.0, 0.0, 1e4]))
    both = {name: torch.cat([away.tensors()[name], t]) for name, t in SCENE.tensors().items()}
    return paint_setup(replace(SCENE, **both), CAMERAS, network)


def behind(mask: torch.Tensor) -> torch.Tensor:
    return torch.cat([torch.zeros(ELSEWHERE, dtype=torch.bool), mask])


def target(mask: torch.Tensor, *styles: torch.Tensor, **settings: Any) -> Painting:
    return Painting("ball", behind(mask), styles, replace(FAST, **settings))


def test_what_the_object_hides_matters_and_what_no_view_shows_does_not(studio: PaintSetup):
    inside = SCENE.means[BALL].mean(dim=0)
    means = studio.splats.means.clone()
    hidden = ELSEWHERE + int((~BALL).nonzero()[0])
    means[hidden] = inside
    scene = replace(studio, splats=replace(studio.splats, means=means))
    part, own = crop_scene(scene, target(BALL))
    rows = own.parents
    assert rows is not None and hidden in rows
    assert torch.isin(ELSEWHERE + BALL.nonzero()[:, 0], rows).all()
    assert (rows >= ELSEWHERE).all() and (rows.diff() > 0).all()
    assert same(part.splats, scene.splats[rows]) and torch.equal(own.mask, behind(BALL)[rows])


def test_views_that_hide_the_object_do_not_matter(studio: PaintSetup):
    """Nor is there a cut if only held-out views show it: that is refused as in the whole scene."""
    away = CAMERAS[0]
    turned = away.viewmats.clone()
    turned[:, :3] *= torch.tensor([-1.0, 1.0, -1.0])[:, None]  # half a turn: it looks elsewhere
    away = replace(away, viewmats=turned, names=("away",))
    part, _ = crop_scene(replace(studio, all_cameras=CAMERAS + away), target(BALL))
    assert part.cameras.names == part.all_cameras.names == CAMERAS.names
    only = replace(studio, cameras=away, all_cameras=away + CAMERAS)
    for whole in (only, replace(studio, all_cameras=CAMERAS + CAMERAS)):
        assert crop_scene(whole, target(BALL))[0] is whole


def test_painted_as_in_the_whole_scene(
    studio: PaintSetup, stripes: torch.Tensor, monkeypatch: pytest.MonkeyPatch
):
    job = target(BALL, stripes)
    cut = paint_objects(studio, [job])
    monkeypatch.setattr(cutting, "VISIBLE_LARGE", len(studio.splats) + 1)
    whole = paint_objects(studio, [job])
    assert not torch.equal(cut.splats.sh0, studio.splats.sh0)
    assert torch.equal(cut.splats.sh0, whole.splats.sh0)
    assert torch.equal(cut.parents, whole.parents)
    assert torch.equal(cut.layers[0].rows, job.mask.nonzero()[:, 0]), "rows of the whole base"


def test_nothing_else_changes_beside_a_canvas(studio: PaintSetup, stripes: torch.Tensor):
    job = target(BALL, stripes, quality="normal")
    styled = paint_objects(studio, [job])
    count = len(studio.splats)
    assert len(styled.splats) == len(styled.parents) > count
    assert job.mask[styled.parents[count:]].all()
    for name, before in studio.splats.tensors().items():
        assert torch.equal(styled.splats.tensors()[name][:count][~job.mask], before[~job.mask])
