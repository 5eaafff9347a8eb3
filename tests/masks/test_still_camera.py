"""A ball of noise that moves before a still room of noise, and its shadow."""

from dataclasses import replace

import torch

from balls import CAMERAS, enlarged
from scenes import randn
from stylesplat.masks.still_camera import cut_out_moving
from stylesplat.metrics.iou import mask_iou
from stylesplat.scene.capture import Capture

VIEWS = enlarged(CAMERAS, 3)
WIDTH, HEIGHT = VIEWS[0].size
ROOM = 0.5 + 0.1 * randn(HEIGHT, WIDTH, 3).clamp(-2, 2)
Y, X = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
BALLS = [(X - 20 - 15 * row) ** 2 + (Y - 50) ** 2 < 15**2 for row in range(len(VIEWS))]


def photo(row: int) -> torch.Tensor:
    """Its ball is red, green and blue in turns, so that its colours do not stay."""
    image = ROOM.clone()
    image[BALLS[row].roll(25, dims=0)] *= 0.7  # as if less light fell there
    image[BALLS[row]] = 0.2 + 0.6 * torch.eye(3)[row % 3]
    return (255 * image).round().to(torch.uint8)


CAPTURE = Capture(VIEWS, [photo(row) for row in range(len(VIEWS))])


def test_what_moves_before_a_still_camera_is_cut_out_without_its_shadow():
    found = cut_out_moving(CAPTURE)
    assert found is not None
    for row, ball in enumerate(BALLS):
        alpha = found.alpha(row)
        assert alpha is not None
        assert mask_iou(alpha > 0, ball) > 0.9
        assert not found.photos[row][alpha == 0].any(), "nothing of the room is left"


def test_photos_of_a_camera_that_moves_stay_whole():
    moved = [each.roll(9 * row, dims=1) for row, each in enumerate(CAPTURE.photos)]
    assert cut_out_moving(replace(CAPTURE, photos=moved)) is None
    assert (
        cut_out_moving(replace(CAPTURE, alphas=[torch.ones_like(CAPTURE.photos[0][..., 0])] * 8))
        is None
    )
