"""A ball of noise that moves before a still room of noise, and its shadow."""

from dataclasses import replace

import torch

from balls import CAMERAS, enlarged
from scenes import randn
from stylesplat.imaging.similarity import mask_iou
from stylesplat.masks.working_splat import segment_moving_object
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
    found = segment_moving_object(CAPTURE)
    assert found is not None
    for row, ball in enumerate(BALLS):
        alpha = found.alpha(row)
        assert alpha is not None
        assert mask_iou(alpha > 0, ball) > 0.9
        assert not found.photos[row][alpha == 0].any(), "nothing of the room is left"


def capture_of(images: list[torch.Tensor]) -> Capture:
    return Capture(VIEWS[[*range(len(images))]], images)


def test_other_photos_stay_whole():
    moved = [each.roll(9 * row, dims=1) for row, each in enumerate(CAPTURE.photos)]
    assert segment_moving_object(capture_of(moved)) is None
    for each in moved:
        each[: HEIGHT // 2] = 255
    assert segment_moving_object(capture_of(moved)) is None, "a plain sky is no room"
    assert segment_moving_object(capture_of([*CAPTURE.photos[:5]])) is None, "too few"
    cut_out = [torch.full((HEIGHT, WIDTH), 255, dtype=torch.uint8)] * len(VIEWS)
    assert segment_moving_object(replace(CAPTURE, alphas=cut_out)) is None


def test_what_has_the_hue_of_its_surroundings_is_not_cut_away():
    """A grey statue in a grey room: each turn looks as if other light fell on it."""
    grey = ROOM.mean(dim=2, keepdim=True).expand_as(ROOM)
    statue = ((X - WIDTH // 2) ** 2 + (Y - 50) ** 2 < 20**2)[..., None]
    lights = (0.5 + 0.1 * randn(HEIGHT, WIDTH, 1).clamp(-2, 2) for _ in VIEWS)
    images = [torch.where(statue, light.expand_as(grey), grey) for light in lights]
    photos = [(255 * image).round().to(torch.uint8) for image in images]
    assert segment_moving_object(capture_of(photos)) is None
