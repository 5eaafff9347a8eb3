"""Photos of an object on a turntable, before a camera that stood still, cut out to what turns.

Poses of such photos are those of the object. The room that stands still contradicts them: a splat
of both is a fog around the object. Each pixel of the room, however, has the same colour in most
photos that do not show the object there.
"""

from dataclasses import replace
from functools import lru_cache, partial

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import binary_fill_holes
from torch import Tensor

from stylesplat.color.lab import linear_rgb
from stylesplat.progress import track
from stylesplat.scene.cache import Lazy
from stylesplat.scene.capture import Capture
from stylesplat.scene.sampling import evenly

PHOTOS = 48  # that tell what stands still
MIN_PHOTOS = 8  # fewer tell nothing
SAME = 10  # of 255, by which colours of a pixel may differ that are the same
STAYS = 0.9  # share of the photos in which a pixel has the same colour if nothing moves there
STILL = 0.2  # share of such pixels from which the camera stood still: .48 on the own turntable,
# .00 around fox, doll, desk and demo
DIFFERS = 0.06  # of a colour channel; less is noise
LIGHT, HUE = 2.5, 0.3  # logarithms of intensities: a shadow's at most, and how it may be tinted
DARK = 0.01  # intensity that is added, so that noise in the dark has no hue
EDGE, EDGES = 0.04, 0.005  # a plain sky is the same in all photos, too: still pixels at an edge
LEAST = 0.02  # of each photo moves, or the object has the hue of what is behind it
SPECK, GAP = 3, 9  # pixels at working size: smaller specks are dropped, narrower gaps closed


@torch.no_grad()
def cut_out_moving(capture: Capture) -> Capture | None:
    """The photos with all transparent but what moves before a camera that stood still.

    Shadows that move are left out where they keep the hue of what they fall on. None if the camera
    moved or too few photos tell, if what moves cannot be told from its surroundings, and for
    photos of several sizes or that are cut out.
    """
    sizes = {camera.size for camera in capture.cameras}
    if len(sizes) > 1 or capture.alphas is not None or len(capture) < MIN_PHOTOS:
        return None
    photos = [capture.photos[row] for row in evenly(range(len(capture)), PHOTOS)]
    still, share = _still(torch.stack(photos))
    stays, grey = share > STAYS, still.mean(dim=-1)
    edges = (grey[1:, 1:] - grey[1:, :-1]).abs() + (grey[1:, 1:] - grey[:-1, 1:]).abs() > EDGE
    if stays.float().mean() < STILL or (edges & stays[1:, 1:]).float().mean() < EDGES:
        return None
    if min(float(_moving(each, still).float().mean()) for each in photos) < LEAST:
        return None

    @lru_cache(maxsize=2)  # the photo is asked for, and then its alpha
    def cut_out(row: int) -> tuple[UInt8[Tensor, "H W 3"], UInt8[Tensor, "H W"]]:
        photo = capture.photos[row]
        moving = _moving(photo, still)
        return photo * moving[..., None], 255 * moving.to(torch.uint8)

    def part(row: int, which: int) -> Tensor:
        return cut_out(row)[which]

    rows = range(len(capture))
    cut_photos, alphas = (Lazy([partial(part, row, which) for row in rows]) for which in (0, 1))
    return replace(capture, photos=cut_photos, alphas=alphas)


def _still(
    photos: UInt8[Tensor, "P H W 3"],
) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "H W"]]:
    """The colour that each pixel has most often, 0 to 1, and its share of the photos."""
    photos = photos.short()
    still, most = photos[0].clone(), photos.new_zeros(photos.shape[1:3])
    for each in track(photos, "looking at what stands still", unit="photo"):
        count = ((photos - each).abs_().amax(dim=-1) < SAME).sum(dim=0).to(most)
        better = count > most
        still[better], most[better] = each[better], count[better]
    same = ((photos - still).abs_().amax(dim=-1) < SAME).float()
    mean = torch.einsum("phw,phwc->hwc", same, photos.float()) / same.sum(dim=0)[..., None]
    return mean / 255, same.mean(dim=0)


def _moving(photo: UInt8[Tensor, "H W 3"], still: Float[Tensor, "H W 3"]) -> Bool[Tensor, "H W"]:
    """Where a photo shows something else than what stands still, in whatever light."""
    image = photo.float() / 255
    change = (linear_rgb(image) + DARK).log() - (linear_rgb(still) + DARK).log()
    light = change.mean(dim=-1, keepdim=True)
    is_light = (light.abs() < LIGHT)[..., 0] & ((change - light).abs().amax(dim=-1) < HUE)
    moves = ((image - still).abs().amax(dim=-1) > DIFFERS) & ~is_light
    moves = moves.numpy().astype(np.uint8)
    moves = cv2.morphologyEx(moves, cv2.MORPH_OPEN, np.ones((SPECK, SPECK), np.uint8))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (GAP, GAP))
    moves = cv2.morphologyEx(moves, cv2.MORPH_CLOSE, disc)
    return torch.from_numpy(binary_fill_holes(moves))
