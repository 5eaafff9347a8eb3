"""What stands still in photos from a camera that did, and what moves before it.

An object on a turntable and the room behind it move in two ways: poses of one of them are wrong for
the other. Each pixel of the room, however, has the same colour in all photos that do not show the
object or its shadow there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int16, UInt8
from scipy.ndimage import binary_fill_holes
from torch import Tensor

from stylesplat.imaging.morphology import apply_disc
from stylesplat.photo_libraries import cv2
from stylesplat.progress import track

STILL_SIDE = 640  # pixels of the longer side of the photos that are looked at
STILL_PHOTOS = 36  # that tell what stands still
STILL_MIN_PHOTOS = 8  # fewer tell nothing
# Levels of 255 by which a colour may differ that is the same; and that of the room, which changes
# by noise alone, behind an object whose own colours change slowly
STILL_SAME_COLOR, STILL_NOISE = 10, 4
# Levels by which light may change what stays, and the share of the photos in which little moves
DAYLIGHT, STAYS = 16, 0.8
# Share of the pixels that stay, from which the camera stood still: .41 before the room of a museum,
# .08 around desk, .00 around fox and a wooden figure
STILL = 0.2
# A plain sky is the same in all photos, too: pixels that stay at an edge. .0048 in that room, .0011
# around desk, .0000 around the others
EDGE, EDGES = 0.04, 0.002
STILL_RIM = 0.95  # of the picture's rim: before a plain wall nothing stands out but what turns
DIFFERS = 0.03  # of a colour channel; less is noise
SWEPT_LEAST = 0.02  # of the picture
SPECK, GAP = 3, 15  # pixels: smaller specks are dropped, narrower gaps closed


@dataclass(frozen=True, eq=False)
class StillBackground:
    colors: Float[Tensor, "H W 3"]
    """That each pixel has most often, 0 to 1."""
    swept: Bool[Tensor, "H W"]
    """Where something moves in any photo: what an object and its shadow sweep over."""

    def moving(self, photo: UInt8[Tensor, "H W 3"]) -> Bool[Tensor, "H W"]:
        """Where a photo shows something else, shadows included; without gaps."""
        return _closed(self.differing(photo))

    def differing(self, photo: UInt8[Tensor, "H W 3"]) -> Bool[Tensor, "H W"]:
        """The same with gaps, where what moves has the colour of what is behind it."""
        differs = _largest(_like(photo, self.colors) - self.colors) > DIFFERS
        return _without_specks(differs & self.swept)


def find_still_background(photos: Sequence[UInt8[Tensor, "H W 3"]]) -> StillBackground | None:
    """What stands still in photos of `STILL_SIDE`, if much does and something moves before it.

    None if the camera moved, too few photos tell, or they differ in size.
    """
    if len(photos) < STILL_MIN_PHOTOS or len({each.shape for each in photos}) > 1:
        return None
    typical = torch.stack([*photos]).median(dim=0).values.float() / 255
    alike = (255 * torch.stack([_like(each, typical) for each in photos])).round().short()
    colors, shares = _most_frequent(alike, STILL_SAME_COLOR)
    lit = torch.stack([_largest(each.float() - 255 * colors) < DAYLIGHT for each in alike])
    stays, grey = lit.float().mean(dim=0) > STAYS, colors.mean(dim=-1)
    edges = (grey[1:, 1:] - grey[1:, :-1]).abs() + (grey[1:, 1:] - grey[:-1, 1:]).abs() > EDGE
    rim = torch.cat([stays[0], stays[-1], stays[:, 0], stays[:, -1]])
    is_room = (edges & stays[1:, 1:]).float().mean() > EDGES
    if stays.float().mean() < STILL or not (is_room or rim.float().mean() > STILL_RIM):
        return None
    swept = apply_disc(_closed(_without_specks(shares < 1)), cv2.MORPH_DILATE, GAP)
    if swept.float().mean() < SWEPT_LEAST:
        return None
    return StillBackground(_most_frequent(alike, STILL_NOISE)[0], swept)


def _like(photo: UInt8[Tensor, "H W 3"], colors: Float[Tensor, "H W 3"]) -> Float[Tensor, "H W 3"]:
    """A photo in the exposure of others, going by what most pixels have in common, 0 to 1."""
    image = photo.float() / 255
    gain = ((colors + 0.01) / (image + 0.01)).flatten(0, 1).median(dim=0).values
    return (image * gain).clamp(max=1)


def _most_frequent(
    photos: Int16[Tensor, "P H W 3"], same: int
) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "H W"]]:
    """The colour that each pixel has most often, 0 to 1, and its share of the photos."""
    still, most = photos[0].clone(), photos.new_zeros(photos.shape[1:3])
    for each in track(photos, "looking at what stands still", unit="photo"):
        count = (_largest(photos - each) < same).sum(dim=0).to(most)
        better = count > most
        still[better], most[better] = each[better], count[better]
    alike = (_largest(photos - still) < same).float()
    mean = torch.einsum("phw,phwc->hwc", alike, photos.float()) / alike.sum(dim=0)[..., None]
    return mean / 255, alike.mean(dim=0)


def _largest(difference: Tensor) -> Tensor:
    """The largest absolute value of three channels, which become absolute themselves.

    `amax` is slow on so short an axis.
    """
    red, green, blue = difference.abs_().unbind(-1)
    return red.maximum(green).maximum(blue)


def _without_specks(mask: Bool[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    return apply_disc(mask, cv2.MORPH_OPEN, SPECK)


def _closed(mask: Bool[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    closed = apply_disc(mask, cv2.MORPH_CLOSE, GAP)
    return torch.from_numpy(np.asarray(binary_fill_holes(closed.numpy())))
