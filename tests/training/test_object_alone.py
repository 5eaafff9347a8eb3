"""A ball of noise that moves around before a still room of noise, and its shadow."""

from dataclasses import replace

import torch

from scenes import randn
from stylesplat.imaging.similarity import mask_iou
from stylesplat.scene.cameras import Cameras, look_at
from stylesplat.scene.capture import Capture
from stylesplat.scene.projection import project
from stylesplat.training.object_alone import object_alone, outline_moving_object

WIDTH, HEIGHT, FOCAL, COUNT = 160, 120, 200.0, 12
ROOM = 0.5 + 0.1 * randn(HEIGHT, WIDTH, 3).clamp(-2, 2)
Y, X = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
AROUND = torch.arange(COUNT) * 2 * torch.pi / COUNT
ORBIT = torch.stack([4 * AROUND.cos(), torch.full((COUNT,), -1.0), 4 * AROUND.sin()], dim=1)
VIEWS = Cameras(
    viewmats=look_at(ORBIT, torch.zeros(3), torch.tensor([0.0, -1.0, 0.0])),
    Ks=torch.tensor([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]).repeat(COUNT, 1, 1),
    sizes=torch.tensor([[WIDTH, HEIGHT]]).repeat(COUNT, 1),
    names=tuple(f"{row:02}.jpg" for row in range(COUNT)),
)
SHOWN = [project(torch.tensor([[0.6, 0.0, 0.2]]), VIEWS[row]) for row in range(COUNT)]
BALLS = [
    (X + 0.5 - x) ** 2 + (Y + 0.5 - y) ** 2 < (0.4 * FOCAL / depth[0]) ** 2
    for ((x, y),), depth in SHOWN
]


def photo(row: int) -> torch.Tensor:
    """Its ball is red, green and blue in turns, so that its colours do not stay."""
    image = ROOM.clone()
    image[BALLS[row].roll((8 * (row % 3), 20), dims=(0, 1))] *= 0.7  # less light falls there
    image[BALLS[row]] = 0.2 + 0.6 * torch.eye(3)[row % 3]
    return (255 * image * (1 - 0.05 * (row % 2))).round().to(torch.uint8)


CAPTURE = Capture(VIEWS, [photo(row) for row in range(len(VIEWS))])


def test_what_turns_before_a_still_camera_is_outlined_without_its_shadow():
    outlines = outline_moving_object(CAPTURE)
    assert outlines is not None
    for outline, ball in zip(outlines, BALLS, strict=True):
        assert mask_iou(outline, ball) > 0.75


def capture_of(images: list[torch.Tensor]) -> Capture:
    return Capture(VIEWS[[*range(len(images))]], images)


def test_a_camera_that_moves_outlines_nothing():
    moved = [each.roll(9 * row, dims=1) for row, each in enumerate(CAPTURE.photos)]
    assert outline_moving_object(capture_of(moved)) is None
    for each in moved:
        each[: HEIGHT // 2] = 255
    assert outline_moving_object(capture_of(moved)) is None, "a plain sky is no room"
    assert outline_moving_object(capture_of([*CAPTURE.photos[:5]])) is None, "too few"
    cut_out = [torch.full((HEIGHT, WIDTH), 255, dtype=torch.uint8)] * len(VIEWS)
    assert outline_moving_object(replace(CAPTURE, alphas=cut_out)) is None


def test_an_object_before_surroundings_that_stay_is_cut_out_by_its_label_maps():
    labels = [each.int() for each in BALLS]
    alone = object_alone(replace(CAPTURE, label_maps=labels))
    assert alone is not None
    for row, ball in enumerate(BALLS):
        alpha, valid = alone.alpha(row), alone.valid(row)
        assert alpha is not None and valid is not None
        assert mask_iou(alpha > 0, ball) > 0.8
        assert not alone.photos[row][alpha == 0].any(), "nothing of the room is left"
        assert not valid[ball.roll(1, dims=1) ^ ball].any(), "pixels of both tell nothing"


def test_an_object_whose_surroundings_move_with_it_is_not_cut_out():
    labels = [each.int() for each in BALLS]
    moved = [each.roll(9 * row, dims=1) for row, each in enumerate(CAPTURE.photos)]
    assert object_alone(replace(capture_of(moved), label_maps=labels)) is None
    assert object_alone(CAPTURE) is None, "no label maps"
    empty = [torch.zeros_like(each) for each in labels]
    assert object_alone(replace(CAPTURE, label_maps=empty), turns=True) is None, "nothing is shown"


def test_what_is_known_to_turn_is_cut_out_though_its_surroundings_change():
    flashed = [each if row % 2 else 255 - each for row, each in enumerate(CAPTURE.photos)]
    capture = replace(capture_of(flashed), label_maps=[each.int() for each in BALLS])
    assert object_alone(capture) is None
    alone = object_alone(capture, turns=True)
    assert alone is not None
    assert not alone.photos[0][alone.alpha(0) == 0].any()


def test_photos_whose_label_maps_show_no_object_are_left_out(said: list[str]):
    labels = [None, torch.zeros(HEIGHT, WIDTH, dtype=torch.int), *[b.int() for b in BALLS[2:]]]
    alone = object_alone(replace(CAPTURE, label_maps=labels))
    assert alone is not None
    assert alone.cameras.names == VIEWS.names[2:]
    assert said == ["Left out, as their label maps show no object: 00.jpg, 01.jpg."]


def test_a_camera_right_above_says_that_nothing_is_outlined(said: list[str]):
    above = replace(VIEWS, viewmats=VIEWS.viewmats[:1].expand_as(VIEWS.viewmats))
    assert outline_moving_object(replace(CAPTURE, cameras=above)) is None
    assert any("not outlined" in line for line in said)
