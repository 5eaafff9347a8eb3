"""GrabCut of one photo: a red disc before a grey wall, both with some noise."""

import pytest
import torch

from scenes import randn
from stylesplat.errors import StyleSplatError
from stylesplat.imaging.similarity import mask_iou
from stylesplat.masks.grabcut import (
    GrabCutImage,
    Stroke,
    color_levels,
    cut_box,
    grabcut_image,
    refine_mask,
)
from stylesplat.scene.capture import Mask

HEIGHT, WIDTH = 60, 80
PHOTO = "a.jpg"
LOOK = (0, 1, 2)


def disc(x: float, y: float, radius: float) -> torch.Tensor:
    rows, columns = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    return (rows - y) ** 2 + (columns - x) ** 2 < radius**2


DISC = disc(40, 30, 14)
BOX = (24.0, 14.0, 57.0, 47.0)


def painted(*masks: torch.Tensor, wall: float = 120.0) -> torch.Tensor:
    """Red where one of the masks is; noise, as GrabCut's mixtures need some spread."""
    photo = torch.full((HEIGHT, WIDTH, 3), wall)
    for mask in masks:
        photo[mask] = torch.tensor([200.0, 40.0, 40.0])
    noise = randn(*photo.shape)
    return (photo + 4 * noise).round().clamp(0, 255).to(torch.uint8)


def seen(photo: torch.Tensor, nearness: torch.Tensor | None = None) -> GrabCutImage:
    return grabcut_image(
        color_levels(photo), torch.ones(HEIGHT, WIDTH) if nearness is None else nearness
    )


NOWHERE, EVERYWHERE = torch.zeros(HEIGHT, WIDTH), torch.ones(HEIGHT, WIDTH)


def test_a_box_gives_what_stands_out_in_it():
    photo = seen(painted(DISC))
    channels, mask = cut_box(photo, BOX, PHOTO)
    assert mask_iou(mask, DISC) > 0.98  # colours this far apart leave some rim pixels to smoothness
    cut_box(seen(painted(disc(20, 20, 9))), (8.0, 8.0, 33.0, 33.0), PHOTO)  # uses up random numbers
    again = cut_box(photo, BOX, PHOTO)
    assert again[0] == channels and torch.equal(again[1], mask)


def test_things_of_its_colour_that_are_far_away_in_the_photo_do_not_matter():
    far = torch.arange(WIDTH).expand(HEIGHT, WIDTH) >= 44
    small, box = disc(20, 20, 9), (8.0, 8.0, 33.0, 33.0)
    _, mask = cut_box(seen(painted(small, far)), box, PHOTO)
    assert mask_iou(mask, small) > 0.95


def test_what_colours_do_not_show_nearness_does():
    nearness = torch.where(DISC, 1.0, 0.2)
    _, mask = cut_box(seen(painted(), nearness), BOX, PHOTO)
    assert mask_iou(mask, DISC) > 0.98


def test_a_box_that_holds_nothing():
    flat = torch.full((HEIGHT, WIDTH, 4), 90, dtype=torch.uint8).numpy()
    with pytest.raises(StyleSplatError, match=r"box in a\.jpg holds looks like .* tighter"):
        cut_box(flat, BOX, PHOTO)


def test_a_contour_moves_to_the_edge_nearby():
    rough = 0.7 * disc(41, 31, 14).float()  # a pixel off to either side
    mask = refine_mask(seen(painted(DISC)), rough, NOWHERE, LOOK)
    assert mask_iou(mask, DISC) > 0.98 > mask_iou(rough > 0.5, DISC)


def test_colours_decide_on_surfaces_that_come_into_view():
    """A splat knows the left half; the right one is news, and as red as the left."""
    half = DISC.clone()
    half[:, 40:] = False
    right = EVERYWHERE.clone()
    right[:, :40] = 0
    photo = seen(painted(DISC))
    assert mask_iou(refine_mask(photo, half.float(), NOWHERE, LOOK), half) > 0.9, "no news"
    mask = refine_mask(photo, half.float(), right, LOOK)
    reach = disc(40, 30, 14) & (torch.arange(WIDTH) < 40 + 8)  # AROUND of the diagonal
    assert (mask & reach).sum() > 0.95 * reach.sum()


def test_what_does_not_show_has_no_mask():
    assert not refine_mask(seen(painted(DISC)), NOWHERE, NOWHERE, LOOK).any()
    assert not refine_mask(seen(painted(DISC)), 0.5 * EVERYWHERE, EVERYWHERE, LOOK).any()


def test_masks_with_too_little_to_learn_from_stay_as_they_are():
    speck = disc(40, 30, 2)
    assert torch.equal(refine_mask(seen(painted(DISC)), speck.float(), NOWHERE, LOOK), speck)
    assert refine_mask(seen(painted(DISC)), EVERYWHERE, NOWHERE, LOOK).all()


def test_strokes_are_believed():
    """A grey bar across the disc is background by its colour, and a red one outside is not."""
    bar = disc(40, 30, 14) & (torch.arange(HEIGHT)[:, None] - 30).abs().le(4)
    photo = seen(painted(DISC & ~bar))
    line = ((30.0, 30.0), (50.0, 30.0))

    def over(*points: tuple[float, float]) -> Mask:
        return Stroke(points, over_object=True).pixels((WIDTH, HEIGHT))

    nothing = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    _, plain = cut_box(photo, BOX, PHOTO)
    _, whole = cut_box(photo, BOX, PHOTO, [(over(*line), nothing)])
    assert not plain[30, 30:51].any() and whole[30, 30:51].all()
    _, less = cut_box(photo, BOX, PHOTO, [(nothing, over((30.0, 22.0), (50.0, 22.0)))])
    assert plain[22, 32:49].all() and not less[22, 30:51].any()
    _, dot = cut_box(photo, BOX, PHOTO, [(over(line[0]), nothing)])
    assert dot[30, 30], "one point is a dot"
