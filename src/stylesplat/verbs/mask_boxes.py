"""`mask --method grabcut`: label maps of objects that the user drew boxes around."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import load
from stylesplat.masks.boxes.grabcut import Box, Stroke, refuse_box
from stylesplat.masks.boxes.spread import Seen, spread
from stylesplat.masks.foreign import overlaid
from stylesplat.scene.cameras import Cameras
from stylesplat.verbs.mask import refuse_masks, write_masks
from stylesplat.verbs.working import with_splat, working_capture

SIZE = 480  # pixels of the longer side at which objects are cut out

Boxes = Sequence[tuple[str, str, Box]]
"""An object's name, a view's, and a rectangle of its pixels at full size."""
Strokes = Sequence[tuple[str, str, Stroke]]
"""An object's name, a view's, and a stroke in its pixels at full size."""


def mask_boxes(
    capture_path: Path,
    boxes: Boxes,
    *,
    strokes: Strokes = (),
    scene: Path | None = None,
    device: str = "auto",
    overwrite: bool = False,
) -> dict[str, Any]:
    """Cut objects out of all photos, from boxes in one or a few, without any model.

    Args:
        capture_path: The capture's folder.
        boxes: Those of the same object have the same name.
        strokes: Over objects, or what is not, in photos with a box around them.
        scene: A scene of the capture; by default a splat is trained for about a minute.
        device: Where to render.
        overwrite: Whether label maps that are there may be replaced.

    Returns:
        As `write_masks` does.

    Raises:
        StyleSplatError: If there is no box, or one is no part of its photo or shows nothing that
            stands out, a stroke has no box, or there are label maps already.
    """
    if not boxes:
        raise StyleSplatError(
            "Nothing says what to mask. Draw a box around an object, --box NAME=VIEW:x0,y0,x1,y1; "
            "find all objects with a model, --method sam2; or take another program's masks, --from."
        )
    refuse_masks(capture_path, overwrite=overwrite)
    full = load(capture_path, masks=False).cameras
    capture = working_capture(capture_path, SIZE)
    placed = [
        (name, full.index(view), _scaled(box, full[full.index(view)], capture.cameras))
        for name, view, box in boxes
    ]
    _refuse_twice(placed, full.names)
    drawn = [
        (name, row := full.index(view), _scaled_stroke(stroke, full[row], capture.cameras))
        for name, view, stroke in strokes
    ]
    _refuse_alone(drawn, placed, full.names)
    working = with_splat(capture_path, capture, scene, device)
    cameras, seen = working.capture.cameras, Seen(working.splats, working.capture)
    names = dict(enumerate(dict.fromkeys(name for name, _, _ in placed), start=1))
    masks = {}
    for id, name in names.items():
        around = [(row, box) for each, row, box in placed if each == name]
        over = [(row, stroke) for each, row, stroke in drawn if each == name]
        masks[id] = spread(working.splats, cameras, seen, around, over)
    maps = {
        view: partial(overlaid, [(id, found[row]) for id, found in masks.items()])
        for row, view in enumerate(cameras.names)
    }
    return write_masks(capture_path, maps, names, overwrite=overwrite)


def _refuse_twice(placed: Sequence[tuple[str, int, Box]], views: Sequence[str]) -> None:
    """Raise a StyleSplatError for a second box around the same object in the same photo."""
    places = [(name, row) for name, row, _ in placed]
    for name, row in places:
        if places.count((name, row)) > 1:
            raise StyleSplatError(
                f"There are several boxes around {name!r} in {views[row]}. Draw one around all of "
                "it, or give them different names."
            )


def _refuse_alone(
    drawn: Sequence[tuple[str, int, Stroke]],
    placed: Sequence[tuple[str, int, Box]],
    views: Sequence[str],
) -> None:
    """Raise a StyleSplatError for a stroke in a photo without a box around its object."""
    for name, row, _ in drawn:
        if (name, row) not in [each[:2] for each in placed]:
            raise StyleSplatError(
                f"There is a stroke for {name!r} in {views[row]}, but no box around it there. "
                f"Draw one as well: --box {name}={views[row]}:x0,y0,x1,y1."
            )


def _scaled_stroke(stroke: Stroke, camera: Cameras, working: Cameras) -> Stroke:
    """A stroke in the pixels of the working size; raises a StyleSplatError if it is outside."""
    (width, height), (name,) = camera.size, camera.names
    for x, y in stroke.points:
        if not (0 <= x < width and 0 <= y < height):
            raise StyleSplatError(
                f"The stroke's point {x:g},{y:g} is outside {name}, which is {width}x{height} "
                "pixels. Give pixels of the photo at full size."
            )
    small = working[working.index(name)].size
    points = tuple((x * small[0] / width, y * small[1] / height) for x, y in stroke.points)
    return replace(stroke, points=points)


def _scaled(box: Box, camera: Cameras, working: Cameras) -> Box:
    """A box in the pixels of the working size; raises a StyleSplatError if it is none."""
    (width, height), (name,) = camera.size, camera.names
    x0, y0, x1, y1 = box
    if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
        raise StyleSplatError(
            f"Box {x0:g},{y0:g},{x1:g},{y1:g} is empty or reaches outside {name}, which is "
            f"{width}x{height} pixels. Give x0,y0,x1,y1 in pixels of the photo at full size."
        )
    small = working[working.index(name)].size
    across, down = small[0] / width, small[1] / height
    scaled = (x0 * across, y0 * down, x1 * across, y1 * down)
    refuse_box(scaled, small, name)
    return scaled
