"""Captures in which the surroundings do not move with the object: it is trained alone.

Before a turntable, whose camera stands still, or a plain wall, poses are those of the object, and
what is around it contradicts them: a splat of both is a fog. Such photos are cut out to the object.

Masks from several sides that hold it and more (its shadow, what moves elsewhere) become its
silhouettes: only the object is inside of most of them. After Laurentini: The Visual Hull Concept,
1994.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, join_names, shell_command
from stylesplat.imaging.morphology import apply_disc
from stylesplat.imaging.still_background import (
    GAP,
    STILL_PHOTOS,
    STILL_SAME_COLOR,
    STILL_SIDE,
    find_still_background,
)
from stylesplat.photo_libraries import cv2
from stylesplat.progress import say, track
from stylesplat.scene.cameras import Cameras, focus_point
from stylesplat.scene.capture import BACKGROUND, Capture, Mask, at_most
from stylesplat.scene.projection import project
from stylesplat.scene.sequences import Lazy, evenly_spaced

OBJECTS_ALONE = "objects_alone"  # in what a scene says of its training
ALONE_SIDE, ALONE_PHOTOS = 160, 24  # pixels of the longer side of the photos that are looked at
ALONE_MARGIN = 5  # pixels around an object
ALONE_FEWEST = 4  # photos that show a pixel without the object
# Share of what is beside the object whose colour stays: .74 where a platter's edge shows before a
# white backdrop, .45 around desk, .13 to .20 around five others
SURROUNDINGS = 0.6
ALONE_RIM = 0.003  # of the longer side: masks are as exact, and pixels there mix both


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


def object_alone(capture: Capture, *, turns: bool = False) -> Capture | None:
    """The photos with all transparent but their objects, if the surroundings stay as they turn.

    What is within `ALONE_RIM` of an outline is left out of training, as are photos without an
    object, which a line names. None if the surroundings are those of the poses, for cut-outs and
    where no photo has an object.

    Args:
        capture: The photos, and their label maps.
        turns: Whether the poses are known to be those of what turns, as they are to `sfm`.
    """
    if capture.alphas is not None or capture.label_maps is None:
        return None
    small = at_most(capture, ALONE_SIDE)
    if not (turns or _stands_still_around(small)):
        return None
    rows = [row for row in range(len(small)) if _objects(small, row) is not None]
    if rows and len(rows) < len(capture):
        unseen = [name for row, name in enumerate(capture.cameras.names) if row not in {*rows}]
        say(f"Left out, as their label maps show no object: {join_names(unseen)}.")
        capture = capture.only(rows)
    return cut_out_labels(capture) if rows else None


def fog_advice(folder: Path) -> str:
    """Advice for a capture of a turntable without masks."""
    box = shell_command("mask", folder, "--box", "VIEW:x0,y0,x1,y1")
    return f"Without masks the room is trained too, and becomes a fog. `{box}` makes them."


def as_trained(capture: Capture, info: Mapping[str, Any]) -> Capture:
    """The photos as a scene with this `info` was trained on them: cut out if objects are alone."""
    if info.get(OBJECTS_ALONE) and capture.label_maps and capture.alphas is None:
        return cut_out_labels(capture)
    return capture


def cut_out_labels(capture: Capture) -> Capture:
    """The photos with all transparent but what their label maps show; see `object_alone`."""
    assert capture.label_maps is not None

    @lru_cache(maxsize=2)  # the photo is asked for, then its alpha and what is valid
    def cut(row: int) -> tuple[UInt8[Tensor, "H W 3"], UInt8[Tensor, "H W"], Mask]:
        labels = capture.labels(row)
        assert labels is not None
        shown = labels != BACKGROUND
        width = 2 * max(1, round(ALONE_RIM * max(shown.shape))) + 1
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


def _objects(capture: Capture, row: int) -> Mask | None:
    """The pixels of objects in a label map; None if it has none."""
    labels = capture.labels(row)
    return None if labels is None or not (labels != BACKGROUND).any() else labels != BACKGROUND


def _stands_still_around(capture: Capture) -> bool:
    """Whether what is beside the objects has the same colours in all photos."""
    rows = evenly_spaced(range(len(capture)), ALONE_PHOTOS)
    shown = {row: mask for row in rows if (mask := _objects(capture, row)) is not None}
    if not shown or len({camera.size for camera in capture.cameras}) > 1:
        return False
    around = [~apply_disc(mask, cv2.MORPH_DILATE, ALONE_MARGIN) for mask in shown.values()]
    photos = torch.stack([capture.photos[row] for row in shown]).float()
    return _share_of_still(photos, torch.stack(around)) > SURROUNDINGS


def _share_of_still(photos: Float[Tensor, "P H W 3"], around: Bool[Tensor, "P H W"]) -> float:
    """Of the pixels beside objects, the share whose colour is the median of all photos there."""
    beside = photos.where(around[..., None], torch.nan)
    gains = (beside.nanmedian(dim=0).values / beside).flatten(1, 2).nanmedian(dim=1).values
    beside = beside * gains[:, None, None]
    same = (beside - beside.nanmedian(dim=0).values).abs().amax(dim=-1) < STILL_SAME_COLOR
    counted = around & (around.sum(dim=0) >= ALONE_FEWEST)
    return float(same[counted].float().mean()) if counted.any() else 0.0


HULL_CELLS = 48  # along each side at first
HULL_LEVELS = 3  # sizes of cells, each half the last
HULL_SHARE = 0.9  # of the masks: some have holes, and a shadow falls on one place in fewer
HULL_PART = 0.02  # of the largest part of a mask: smaller ones are noise
HULL_SEEN = 0.5  # share of the photos that have to show a place


def silhouettes(
    masks: Sequence[Bool[Tensor, "H W"]], cameras: Cameras
) -> list[Bool[Tensor, "H W"]]:
    """The parts of masks that show what is inside of most of them.

    Args:
        masks: One for each camera, of its size; each holds the object.
        cameras: They stand around it and look at it.
    """
    cells, size = _carve(masks, cameras)
    outlines = (_outline(cells, size, cameras[row]) for row in range(len(cameras)))
    return [_large_parts(mask & each) for mask, each in zip(masks, outlines, strict=True)]


def _carve(
    masks: Sequence[Bool[Tensor, "H W"]], cameras: Cameras
) -> tuple[Float[Tensor, "N 3"], float]:
    """The middles of cells at the surface of the hull, and how long their sides are."""
    middle, reach = _extent(masks, cameras)
    steps = (torch.arange(HULL_CELLS) + 0.5) / HULL_CELLS * 2 - 1
    cells = middle + reach * torch.cartesian_prod(steps, steps, steps)
    size = 2 * reach / HULL_CELLS
    most_outside = round((1 - HULL_SHARE) * len(masks), 6)  # masks, of a cell that is kept
    for level in track(range(HULL_LEVELS), "finding outlines"):
        is_last = level == HULL_LEVELS - 1
        seen, inside, deep = (torch.zeros(len(cells)) for _ in range(3))
        for row, mask in enumerate(masks):
            camera = cameras[row]
            places, shown = _places(cells, camera)
            x, y = (places * shown[:, None]).unbind(1)  # those that are not shown count nowhere
            at = y * camera.size[0] + x
            if not is_last:  # a cell counts if any of it may be inside
                width = _pixels(size, camera, middle)
                deep += ~_dilated(~mask, width).flatten().take(at) & shown
                mask = _dilated(mask, width)
            seen += shown
            inside += mask.flatten().take(at) & shown
            kept = seen - inside <= most_outside  # most cells are ruled out by the first masks
            cells, seen, inside, deep = (each[kept] for each in (cells, seen, inside, deep))
        is_hull = (seen >= HULL_SEEN * len(masks)) & (inside >= HULL_SHARE * seen)
        # What is deep within all masks is hidden by what is around it, as far as cells reach
        around = (cells - middle).abs().amax(dim=1) > reach - size
        cells = cells[is_hull & ((deep < len(masks)) | around)]
        if not is_last:
            corners = size / 4 * torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3)
            cells, size = (cells[:, None] + corners).flatten(0, 1), size / 2
    return cells, size


def _extent(
    masks: Sequence[Bool[Tensor, "H W"]], cameras: Cameras
) -> tuple[Float[Tensor, "3"], float]:
    """Where the cameras look, and how far from there the masks reach in any of them."""
    middle = focus_point(cameras).float()
    farthest = 0.0
    for row, mask in enumerate(masks):
        camera = cameras[row]
        place, depth = (each[0] for each in project(middle[None], camera))
        if mask.any() and depth > 0:
            away = (mask.nonzero().flip(1) + 0.5 - place).norm(dim=1)
            angle = float(np.quantile(away.numpy(), 0.99)) / float(camera.Ks[0, 0, 0])
            farthest = max(farthest, min(1.0, angle) * float(depth))
    return middle, farthest


def _places(
    points: Float[Tensor, "N 3"], camera: Cameras
) -> tuple[Int[Tensor, "N 2"], Bool[Tensor, " N"]]:
    """The pixels that show points, and whether the camera does."""
    places, depths = project(points, camera)
    size = torch.tensor(camera.size)
    shown = ((places >= 0) & (places < size)).all(dim=1) & (depths > 0)
    return places.nan_to_num().clamp(-1, max(camera.size)).long(), shown


def _pixels(size: float, camera: Cameras, place: Float[Tensor, "3"]) -> int:
    """How many pixels wide something is at a place, rounded up."""
    distance = float((camera.positions[0] - place).norm())
    return int(np.ceil(float(camera.Ks[0, 0, 0]) * size / distance))


def _dilated(mask: Bool[Tensor, "H W"], width: int) -> Bool[Tensor, "H W"]:
    kernel = np.ones((2 * width + 1, 2 * width + 1), np.uint8)
    return torch.from_numpy(cv2.dilate(mask.numpy().astype(np.uint8), kernel) > 0)


def _outline(cells: Float[Tensor, "N 3"], size: float, camera: Cameras) -> Bool[Tensor, "H W"]:
    width, height = camera.size
    picture = torch.zeros(height, width, dtype=torch.bool)
    if len(cells):
        places, shown = _places(cells, camera)
        x, y = places[shown].T
        picture[y, x] = True
    # cells lie apart in the picture; what is outside of the mask is left out by it
    return _dilated(picture, _pixels(size, camera, cells.mean(dim=0)) if len(cells) else 0)


def _large_parts(mask: Bool[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    _, parts, figures, _ = cv2.connectedComponentsWithStats(mask.numpy().astype(np.uint8))
    areas = figures[:, cv2.CC_STAT_AREA]
    areas[0] = 0  # what is beside the mask
    return torch.from_numpy((areas > HULL_PART * areas.max())[parts])
