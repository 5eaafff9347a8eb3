"""Views that show an object best, and cuts through them."""

from dataclasses import replace

import pytest
import torch
from torch.nn.functional import normalize

from balls import CAMERAS, SPLATS, enlarged
from stylesplat.figures.best_views import (
    best_rows,
    find_views,
    most_detailed,
)
from stylesplat.scene.cameras import Cameras
from stylesplat.selection.labels import pick

RED = pick(SPLATS, object_id=3, remove_outliers=False)
HIDDEN = torch.zeros_like(RED)
HIDDEN[200] = True  # inside the red ball once it is moved there
SHRUNK = replace(
    SPLATS,
    means=SPLATS.means.index_copy(0, torch.tensor([200]), torch.tensor([[-0.7, 0.0, 0.3]])),
    scales=SPLATS.scales.index_fill(0, torch.tensor([200]), -6.0),
)


def turned_away(cameras: Cameras) -> Cameras:
    """The cameras, looking back over their shoulders."""
    flip = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0]))
    return replace(cameras, viewmats=flip @ cameras.viewmats)


def test_three_views_from_sides_that_differ():
    found = find_views(SPLATS, CAMERAS, RED)
    assert len({shown.row for shown in found}) == len(found) == 3
    sizes = [int(shown.mask.sum()) for shown in found]
    everywhere = [int(s.mask.sum()) for s in find_views(SPLATS, CAMERAS, RED, count=8)]
    assert sizes[0] == max(everywhere)
    directions = torch.nn.functional.normalize(CAMERAS.positions[[s.row for s in found]], dim=1)
    angles = (directions @ directions.T)[~torch.eye(3, dtype=torch.bool)].acos()
    assert angles.min() > 0.6  # of cameras an eighth of a circle apart, no two neighbours


def test_another_side_is_worth_more_than_the_same_again():
    cameras = CAMERAS[[0, 0, 0, 2]]
    scores = {0: 9.0, 1: 10.0, 2: 9.5, 3: 6.0}
    surface = SPLATS.means[RED]
    assert best_rows(cameras, surface, scores, 2) == [1, 3]
    assert best_rows(cameras, surface, scores | {3: 0.0}, 4)[0] == 1
    assert 3 not in best_rows(cameras, surface, scores | {3: 0.0}, 4)
    hardly = {0: 10.0, 2: 8.0, 4: 0.5}
    assert best_rows(CAMERAS, surface, hardly, 2) == [0, 2], "the opposite side shows hardly any"


def test_as_many_as_show_it():
    cameras = CAMERAS[:1] + turned_away(CAMERAS[1:])
    assert [shown.row for shown in find_views(SPLATS, cameras, RED)] == [0]
    assert not find_views(SPLATS, turned_away(CAMERAS), RED)
    assert not find_views(SHRUNK, CAMERAS, HIDDEN), "something is in front of it in every view"


@pytest.mark.parametrize("face", [0, 3])
def test_the_side_with_a_face_is_shown_rather_than_the_back(face: int):
    """A ball with dark spots on the side to one camera; others may show a little more of it."""
    cameras = enlarged(CAMERAS, 2)
    centre = SPLATS.means[RED].mean(dim=0)
    to_camera = normalize(cameras.positions[face] - centre, dim=0)
    facing = normalize(SPLATS.means - centre, dim=1) @ to_camera > 0.5
    spots = RED & facing & (torch.arange(len(RED)) % 2 == 0)
    scene = replace(SPLATS, sh0=torch.where(spots[:, None, None], -1.7, SPLATS.sh0))
    best = most_detailed(scene, cameras, find_views(scene, cameras, RED, count=len(cameras)))
    away = (best.row - face) % len(cameras)
    assert min(away, len(cameras) - away) <= 1
