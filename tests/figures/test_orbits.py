import math
from dataclasses import replace

import pytest
import torch

from balls import CAMERAS
from scenes import figure, floaters, guitar, joined, room, shares
from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras, look_at
from stylesplat.scene.content import content_of
from stylesplat.scene.splats import Splats
from stylesplat.scene.virtual_cameras import (
    FILLED,
    orbit_around,
    orbit_cameras,
    ring_cameras,
    turned_view,
    zoom_to_content,
)

UP = torch.tensor([0.0, 0.0, 1.0]).double()


def arc(angles: list[float]) -> Cameras:
    positions = torch.tensor([[3 * math.sin(a), -3 * math.cos(a), 1.0] for a in angles])
    viewmats = look_at(positions, torch.zeros(3), UP.float())
    return replace(CAMERAS[: len(angles)], viewmats=viewmats)


def azimuths(cameras: Cameras) -> torch.Tensor:
    x, y, _ = cameras.positions.unbind(-1)
    return torch.atan2(x, -y)


def test_all_frames_look_at_the_focus_upright():
    orbit = orbit_cameras(replace(CAMERAS, sizes=torch.tensor([47, 35]).expand(8, 2)), 12)
    assert orbit.size == (46, 34) and orbit.Ks[0, :2, 2].tolist() == [23, 17]
    assert len(set(orbit.names)) == 12
    target = orbit.viewmats @ torch.tensor([0.0, 0.0, 0.0, 1.0])
    assert target[:, :2].abs().max() < 1e-4  # on the optical axis
    assert (target[:, 2] > 1).all()
    assert (orbit.viewmats[:, 1, :3] @ UP.float() < -0.5).all()
    assert torch.allclose(torch.linalg.det(orbit.viewmats), torch.ones(12), atol=1e-5)
    assert torch.allclose(orbit.positions[:, 2], torch.full((12,), 1.5), atol=1e-4)
    assert torch.allclose(orbit.positions[:, :2].norm(dim=1), torch.full((12,), 3.0), atol=1e-4)


def test_a_view_turns_around_a_point():
    centre = torch.tensor([0.3, -0.2, 0.5])
    circle = turned_view(CAMERAS[1], centre, UP, 8, "circle")
    swing = turned_view(CAMERAS[1], centre, UP, 8, "swing")
    for path, turned in ((circle, 360), (swing, 0)):
        assert torch.allclose(path.viewmats[0], CAMERAS.viewmats[1], atol=1e-5)
        assert torch.allclose(path.positions[:, 2], CAMERAS.positions[1, 2], atol=1e-5)
        outward = path.positions[:, :2] - centre[:2]
        assert torch.allclose(outward.norm(dim=1), outward[0].norm(), atol=1e-5)
        angles = torch.atan2(outward[:, 1], outward[:, 0])
        steps = (angles.roll(-1) - angles + math.pi) % (2 * math.pi) - math.pi
        assert math.degrees(float(steps.sum().abs())) == pytest.approx(turned, abs=0.01)
        assert steps.abs().max() > math.radians(20)


def test_without_photos_behind_the_path_stays_in_front():
    angles = [2.6, 2.9, 3.2, 3.5]  # across the cut of atan2
    path = azimuths(orbit_cameras(arc(angles), 40)) % (2 * math.pi)
    assert path.min() > 2.6 - 1e-3 and path.max() < 3.5 + 1e-3
    assert path.max() - path.min() > 0.85


def test_cameras_that_look_at_nothing_in_common():
    rows = CAMERAS[0].viewmats.repeat(3, 1, 1)
    rows[:, 0, 3] += torch.arange(3)
    with pytest.raises(StyleSplatError, match=r"same way.*--views all"):
        orbit_cameras(replace(CAMERAS[:3], viewmats=rows), 10)
    flip = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(StyleSplatError, match=r"outwards.*--views all"):
        orbit_cameras(replace(CAMERAS, viewmats=flip @ CAMERAS.viewmats), 10)


@pytest.mark.parametrize(
    ("splats", "own"),
    [(guitar(), 3300), (joined(figure(), floaters()), 4000), (room(), 6000)],
    ids=["guitar", "figure", "room"],
)
def test_without_photos_all_content_is_in_every_frame(splats: Splats, own: int):
    views = ring_cameras(splats, UP.float())
    path = orbit_around(content_of(splats), views, 24)
    assert min(shares(path, splats.means[:own])) > 0.99
    steps = (path.positions.roll(-1, 0) - path.positions).norm(dim=1)
    assert steps.max() < 1.5 * steps.min(), "closed and even"
    assert path.size == views.size and len(set(path.names)) == 24
    if own == 6000:
        assert path.positions[:, :2].abs().max() < 3, "within the walls"


def test_an_object_fills_the_pictures_of_its_round_trip():
    splats = guitar()
    content = content_of(splats, torch.ones(len(splats), dtype=torch.bool))
    cameras = arc([-0.5, 0.0, 0.5]).resize(100, 60)
    path = zoom_to_content(orbit_cameras(cameras, 8, content.extent.centre), content)
    assert path.size == (100, 60)
    places = torch.nn.functional.pad(content.outline.float(), (0, 1), value=1)
    seen = torch.einsum("cij,cjk,pk->cpi", path.Ks, path.viewmats[:, :3], places)
    spread = (seen[..., :2] / seen[..., 2:] - torch.tensor([50.0, 30.0])).abs()
    filling = (spread / torch.tensor([50.0, 30.0])).amax()
    assert math.isclose(float(filling), FILLED, rel_tol=1e-3)
