"""The working frame: level, centred, of a fixed scale, whatever the frame before."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from stylesplat.scene.cameras import Cameras, look_at, up_vector
from stylesplat.scene.frames import Frame, move_cameras
from stylesplat.structure_from_motion.world_frame import find_centre, working_frame

UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
NOTHING = torch.zeros(0, 3)


def degrees(one: Tensor, other: Tensor) -> float:
    return math.degrees(math.acos(float((one.double() @ other.double()).clamp(-1, 1))))


def up_of(frame: Frame) -> Tensor:
    """The direction in the world before that is up, -y, afterwards."""
    return -frame.rotation[1]


def cameras_at(positions: Tensor, target: Tensor) -> Cameras:
    count = len(positions)
    K = torch.tensor([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    return Cameras(
        viewmats=look_at(positions.double(), target.double(), UP).float(),
        Ks=K.expand(count, 3, 3).clone(),
        sizes=torch.tensor([640, 480]).expand(count, 2).clone(),
        names=tuple(f"{row:03d}.jpg" for row in range(count)),
    )


def held_by_hand(cameras: Cameras, *, roll: float, seed: int = 0) -> Cameras:
    """Each camera rolled by some degrees, and aimed half as badly."""
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(len(cameras), 3, generator=generator) * math.radians(roll)
    noise *= torch.tensor([0.5, 0.5, 1.0])
    skew = torch.zeros(len(cameras), 3, 3)
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        skew[:, i, j], skew[:, j, i] = -noise[:, axis], noise[:, axis]
    viewmats = cameras.viewmats.clone()
    turn = torch.eye(4).repeat(len(cameras), 1, 1)
    turn[:, :3, :3] = torch.linalg.matrix_exp(skew)
    return replace(cameras, viewmats=turn @ viewmats)


def walk(start: float, end: float, count: int, height: float = 1.5) -> Cameras:
    """Around the table, by angles in degrees, at a distance of 3, looking down at it."""
    turns = torch.linspace(math.radians(start), math.radians(end), count)
    places = torch.stack([3 * turns.cos(), 3 * turns.sin(), 0 * turns + height], dim=1)
    return held_by_hand(cameras_at(places, torch.tensor([0.0, 0.0, 0.3])), roll=3)


def table(count: int = 1500) -> Tensor:
    """Things on a table, and far strays."""
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    points[: count // 20] *= 60
    return points


def test_up_is_what_hands_agree_on():
    around = walk(0, 350, 30)  # rolls of 3 degrees in 30 photos leave half a degree
    assert degrees(up_of(working_frame(around, NOTHING)), UP) < 2


@pytest.mark.parametrize("quarters", [1, 3])
def test_photos_on_their_side_were_taken_around_something_not_over_and_under_it(quarters: int):
    upright, turn = walk(0, 300, 20), torch.eye(4)
    turn[:2, :2] = torch.matrix_power(torch.tensor([[0.0, -1.0], [1.0, 0.0]]), quarters)
    sideways = replace(upright, viewmats=turn @ upright.viewmats)
    assert degrees(up_of(working_frame(sideways, NOTHING)), UP) < 2
    assert degrees(up_vector(sideways), UP) < 2, "as for views of a capture from elsewhere"
    over = sideways[:8]  # through 110 degrees, which may lead over it
    assert degrees(up_of(working_frame(over, NOTHING)), UP) > 60


def test_upright_photos_stay_upright_however_they_are_pitched():
    generator = torch.Generator().manual_seed(0)
    turns = torch.cat(
        [
            torch.randn(40, generator=generator) * 0.3,
            torch.rand(20, generator=generator) * 2 * math.pi,
        ]
    )
    places = torch.stack([3 * turns.cos(), 3 * turns.sin(), 0 * turns + 1.5], dim=1)
    pitches = torch.rand(60, generator=generator) * 1.3 - 0.8
    aims = 1.5 * UP + torch.tan(pitches)[:, None] * 3 * UP
    cameras = [
        cameras_at(place[None], aim).viewmats for place, aim in zip(places, aims, strict=True)
    ]
    pitched = replace(cameras_at(places, torch.zeros(3)), viewmats=torch.cat(cameras))
    assert degrees(up_vector(pitched), UP) < 5
    assert degrees(up_of(working_frame(pitched, NOTHING)), UP) < 5


def test_centre_scale_and_heading():
    cameras, points = walk(-60, 60, 24), table()
    frame = working_frame(cameras, points)
    there = move_cameras(cameras, frame)
    assert there.positions.norm(dim=1).median() == pytest.approx(1, abs=1e-5)
    thing = frame.place(torch.tensor([[0.0, 0.0, 0.3]]))
    assert thing.norm() < 0.03, "what they look at, but for the noise of their hands"
    views = there.viewmats[:, 2, :3].mean(dim=0)
    assert abs(views[0]) < 1e-5 and views[2] > 0.5 and views[1] > 0.1, "ahead, and down"
    around = walk(0, 350, 36)
    first = move_cameras(around, working_frame(around, points)).viewmats[0, 2, :3]
    assert abs(first[0]) < 1e-5 and first[2] > 0.5, "all around: the first photo looks ahead"


@pytest.mark.parametrize(("seed", "with_points"), [(0, True), (2, True), (1, False)])
def test_any_frame_before_leads_to_the_same(seed: int, with_points: bool):
    cameras, points = walk(-60, 60, 24), table() if with_points else NOTHING
    generator = torch.Generator().manual_seed(seed)
    turn, _ = torch.linalg.qr(torch.randn(3, 3, generator=generator))
    turn = turn * torch.linalg.det(turn).sign()
    other = Frame(turn, 10.0 ** (seed - 1), 5 * torch.randn(3, generator=generator))
    first = move_cameras(cameras, working_frame(cameras, points))
    moved, places = move_cameras(cameras, other), other.place(points)
    second = move_cameras(moved, working_frame(moved, places))
    # Poses are of 32 bits, and lie up to ten units from the origin
    torch.testing.assert_close(second.viewmats, first.viewmats, atol=3e-4, rtol=0)


@pytest.mark.parametrize("meeting", [900.0, 12.0])
def test_views_that_meet_far_behind_or_never_go_by_the_points(meeting: float):
    places = torch.stack([torch.linspace(-1, 1, 9), torch.full((9,), -4.0), torch.zeros(9)], dim=1)
    level = cameras_at(places, torch.tensor([0.0, meeting, 0.0]))
    wall = torch.rand(400, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    wall[:, 1] = 0
    centre = find_centre(level, wall)
    assert centre.position.norm() < 0.15 and not centre.outward
    frame = working_frame(level, wall)
    assert 3.5 < 1 / frame.scale < 4.5


def test_a_room_seen_from_within():
    turns = torch.linspace(0, 2 * math.pi, 13)[:-1]
    rim = torch.stack([turns.cos(), turns.sin(), 0 * turns], dim=1)
    viewmats = [cameras_at(0.3 * one[None], 5 * one).viewmats for one in rim]
    cameras = replace(cameras_at(rim, torch.zeros(3)), viewmats=torch.cat(viewmats))
    walls = 5 * torch.nn.functional.normalize(
        torch.randn(600, 3, generator=torch.Generator().manual_seed(0)), dim=1
    )
    centre = find_centre(cameras, walls)
    assert centre.outward and centre.position.norm() < 1
    assert degrees(up_of(working_frame(cameras, walls)), UP) < 1


@pytest.mark.parametrize(("count", "few"), [(1, 0), (2, 1), (12, 4)])
def test_hardly_anything_still_gives_a_frame(count: int, few: int):
    line = torch.stack(
        [torch.arange(count) * 0.3, torch.full((count,), -2.0), torch.ones(count)], 1
    )
    cameras = cameras_at(line, line[0] + torch.tensor([0.0, 50.0, 0.0]))
    frame = working_frame(cameras, table()[:few])
    assert frame.rotation.isfinite().all() and 0 < frame.scale < math.inf
    torch.testing.assert_close(frame.rotation @ frame.rotation.T, torch.eye(3).double())
    assert torch.linalg.det(frame.rotation) == pytest.approx(1)
    assert degrees(up_of(frame), UP) < 16, "even that of a plane that is none is near level"
