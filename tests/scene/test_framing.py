from dataclasses import replace

import pytest
import torch

from balls import SPLATS
from scenes import UP, figure, floaters, guitar, joined, painting, room, shares
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras, up_vector
from stylesplat.scene.content import content_of
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.scene.virtual_cameras import has_rendered_views, ring_cameras


def close_ups(cameras: Cameras) -> list[int]:
    return [row for row in range(len(cameras)) if row % 4 == 3]


@pytest.mark.parametrize(
    ("splats", "own"),
    [
        (guitar(), None),
        (joined(figure(), floaters()), 4000),
        (painting(), None),
        (room(), 6000),
        (SPLATS, None),
    ],
    ids=["guitar", "figure and floaters", "painting", "room", "balls"],
)
def test_all_content_is_in_three_of_four_views_and_some_are_close_ups(
    splats: Splats, own: int | None
):
    cameras = ring_cameras(splats, UP)
    found = shares(cameras, splats.means[:own])
    whole = [share for row, share in enumerate(found) if row % 4 != 3]
    assert min(whole) > 0.99, "those that the content's edge leaves out"
    assert min(found[row] for row in close_ups(cameras)) > 0.01
    assert max(found[row] for row in close_ups(cameras)) < 1
    places, _ = project(content_of(splats).points, cameras[0])
    lengths = (places.amax(dim=0) - places.amin(dim=0)) / torch.tensor(cameras.size)
    assert 0.6 < lengths.max() < 1, "and fills the picture"


def test_cameras_stand_within_the_walls_of_a_room():
    splats, cameras = room(), ring_cameras(room(), UP)
    assert cameras.positions[:, :2].abs().max() < 3
    assert cameras.positions[:, 2].max() < 2
    things = torch.arange(len(splats)) < 6000
    for row in (0, 1, 5):
        image, _, _ = rasterize(
            splats, cameras[row].downscale(8), features=things.float()[:, None], sh_degree=0
        )
        assert image[0, 45, 60, 3] > 0.9, "no wall hides what is in the middle"


@pytest.mark.parametrize("up", [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
def test_up_is_the_one_that_was_asked_for(up: list[float]):
    cameras = ring_cameras(SPLATS, torch.tensor(up))
    assert len(set(cameras.names)) == len(cameras) > 20
    assert has_rendered_views(Scene(SPLATS, cameras))
    renamed = replace(cameras, names=tuple(f"{row}.jpg" for row in range(len(cameras))))
    assert not has_rendered_views(Scene(SPLATS, renamed))
    torch.testing.assert_close(up_vector(cameras).float(), torch.tensor(up), atol=0.01, rtol=0)
