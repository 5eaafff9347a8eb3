"""Captures in which the surroundings do not move with the object: it is trained alone.

Before a turntable, whose camera stands still, or a plain wall, poses are those of the object, and
what is around it contradicts them: a splat of both is a fog. Such photos are cut out to the object.
"""

from dataclasses import replace
from functools import lru_cache, partial

import cv2
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.imaging.still_background import (
    GAP,
    STILL_PHOTOS,
    STILL_SAME_COLOR,
    STILL_SIDE,
    apply_disc,
    find_still_background,
)
from stylesplat.imaging.visual_hull import silhouettes
from stylesplat.progress import say, track
from stylesplat.scene.capture import BACKGROUND, Capture, Mask, at_most
from stylesplat.scene.sequences import Lazy, evenly_spaced

OBJECTS_ALONE = "objects_alone"  # in what a scene says of its training
ALONE_SIDE, ALONE_PHOTOS = 160, 24  # pixels of the longer side of the photos that are looked at
ALONE_MARGIN = 5  # pixels around an object
ALONE_FEWEST = 4  # photos that show a pixel without the object
SURROUNDINGS = 0.8  # share of what is beside the object whose colour stays
RIM = 0.003  # of the longer side: masks are as exact, and pixels there mix both


@torch.no_grad()
def outline_moving_object(capture: Capture) -> list[Mask] | None:
    """Masks of what turns before a camera that stood still, at most `STILL_SIDE` in size.

    Its shadow is left out, since it stays where the light falls while the object turns. None if the
    camera moved or too few photos tell, and for photos of several sizes or that are cut out; after
    a line that says so where the cameras look down the axis.
    """
    if capture.alphas is not None:
        return None
    small = at_most(capture, STILL_SIDE)
    still = find_still_background(
        [small.photos[row] for row in evenly_spaced(range(len(small)), STILL_PHOTOS)]
    )
    if still is None:
        return None
    moving = [still.moving(photo) for photo in track(small.photos, "cutting out", unit="photo")]
    try:
        outlines = silhouettes(moving, small.cameras)
    except StyleSplatError as error:  # from right above, all look the same way
        say(f"What turns is not outlined: {error}")
        return None
    # `moving` closes bays of an outline as well as gaps within
    return [
        outline & (still.differing(photo) | apply_disc(outline, cv2.MORPH_ERODE, GAP))
        for outline, photo in zip(outlines, small.photos, strict=True)
    ]


def object_alone(capture: Capture) -> Capture | None:
    """The photos with all transparent but their objects, if the surroundings stay as they turn.

    What is within `RIM` of an outline is left out of training. None if the surroundings are those
    of the poses, if a photo has no label map or none has an object, and for cut-outs.
    """
    if capture.alphas is not None or not _stands_still_around(capture):
        return None
    return cut_out_labels(capture)


def cut_out_labels(capture: Capture) -> Capture:
    """The photos with all transparent but what their label maps show; see `object_alone`."""
    assert capture.label_maps is not None

    @lru_cache(maxsize=2)  # the photo is asked for, then its alpha and what is valid
    def cut(row: int) -> tuple[UInt8[Tensor, "H W 3"], UInt8[Tensor, "H W"], Mask]:
        labels = capture.labels(row)
        assert labels is not None
        shown = labels != BACKGROUND
        width = 2 * max(1, round(RIM * max(shown.shape))) + 1
        inside = apply_disc(shown, cv2.MORPH_ERODE, width)
        near = apply_disc(shown, cv2.MORPH_DILATE, width)
        valid, given = inside | ~near, capture.valid(row)
        valid = valid if given is None else valid & given
        return capture.photos[row] * inside[..., None], 255 * inside.to(torch.uint8), valid

    def part(row: int, which: int) -> Tensor:
        return cut(row)[which]

    rows = range(len(capture))
    photos, alphas, valid = (Lazy([partial(part, row, w) for row in rows]) for w in range(3))
    return replace(capture, photos=photos, alphas=alphas, valid_masks=valid)


def _stands_still_around(capture: Capture) -> bool:
    """Whether what is beside the objects has the same colours in all photos."""
    if capture.label_maps is None or len({camera.size for camera in capture.cameras}) > 1:
        return False
    small = at_most(capture, ALONE_SIDE)
    photos, around = list[UInt8[Tensor, "H W 3"]](), list[Mask]()
    for row in evenly_spaced(range(len(small)), ALONE_PHOTOS):
        labels = small.labels(row)
        if labels is None or not (labels != BACKGROUND).any():
            return False
        photos.append(small.photos[row])
        around.append(~apply_disc(labels != BACKGROUND, cv2.MORPH_DILATE, ALONE_MARGIN))
    return _share_of_still(torch.stack(photos).float(), torch.stack(around)) > SURROUNDINGS


def _share_of_still(photos: Float[Tensor, "P H W 3"], around: Bool[Tensor, "P H W"]) -> float:
    """Of the pixels beside objects, the share whose colour is the median of all photos there."""
    beside = photos.where(around[..., None], torch.nan)
    gains = (beside.nanmedian(dim=0).values / beside).flatten(1, 2).nanmedian(dim=1).values
    beside = beside * gains[:, None, None]
    same = (beside - beside.nanmedian(dim=0).values).abs().amax(dim=-1) < STILL_SAME_COLOR
    counted = around & (around.sum(dim=0) >= ALONE_FEWEST)
    return float(same[counted].float().mean()) if counted.any() else 0.0
