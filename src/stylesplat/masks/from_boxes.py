"""`mask --method grabcut`: label maps of objects that the user drew boxes around."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import cast

from stylesplat.errors import StyleSplatError
from stylesplat.masks.box_propagation import grabcut_images, propagate_boxes
from stylesplat.masks.grabcut import Box, Stroke, refuse_box
from stylesplat.masks.import_masks import overlay_masks
from stylesplat.masks.quick_splat import with_label_maps, working_splat
from stylesplat.scene.arguments import Places, check_box, parse_places
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, at_most
from stylesplat.scene.scene import Scene, check_name

SIZE = 480  # pixels of the longer side at which objects are cut out

PlacedStroke = tuple[str, Stroke]
"""A view's name, and a line in pixels of its photo at full size."""
Boxes = Mapping[str, Places]
"""By object's name views, and left, top, right, bottom in pixels of the photo at full size."""
Strokes = Mapping[str, PlacedStroke | Sequence[PlacedStroke]]
"""By object's name."""


def mask_boxes(
    capture: Capture, boxes: Boxes, strokes: Strokes, *, scene: Scene | None, device: str
) -> Capture:
    """Cut objects out of all photos, from boxes in one or a few, without any model.

    Raises:
        StyleSplatError: If there is no box, or one is no part of its photo or shows nothing that
            stands out, a stroke has no box, or an object cannot be called so.
    """
    refuse_without_box(boxes)
    small = at_most(capture, SIZE)
    around = _place_boxes(boxes, capture.full_cameras, small.cameras)
    over = _place_strokes(strokes, around, capture.full_cameras, small.cameras)
    working = working_splat(small, scene, device)
    cameras, images = working.capture.cameras, grabcut_images(working.splats, working.capture)
    names = dict(enumerate(boxes, start=1))
    masks = {
        id: propagate_boxes(
            working.splats,
            cameras,
            images,
            [(row, box) for (each, row), box in around.items() if each == name],
            [(row, stroke) for each, row, stroke in over if each == name],
            name=name,
        )
        for id, name in names.items()
    }
    maps = [
        partial(overlay_masks, [(id, found[row]) for id, found in masks.items()])
        for row in range(len(capture))
    ]
    return with_label_maps(capture, maps, names)


def refuse_without_box(boxes: Boxes) -> None:
    """Raise a StyleSplatError if there is no box, or an object cannot be called so."""
    if not boxes or not all(boxes.values()):
        raise StyleSplatError(
            "Nothing says what to mask. Draw a box around an object, --box NAME=VIEW:x0,y0,x1,y1; "
            "find all objects with a model, --method sam2; or take another program's masks, --from."
        )
    for name in boxes:
        check_name(name)


def _place_boxes(boxes: Boxes, full: Cameras, small: Cameras) -> dict[tuple[str, int], Box]:
    """Boxes in pixels of the working size, by object's name and row of the view."""
    placed: dict[tuple[str, int], Box] = {}
    for name, places in boxes.items():
        for view, box in parse_places(places, 4, "boxes"):
            row = full.index(view)
            if (name, row) in placed:
                raise StyleSplatError(
                    f"There are several boxes around {name!r} in {full.names[row]}. Draw one "
                    "around all of it, or give them different names."
                )
            x0, y0, x1, y1 = check_box(box, full[row].size, full.names[row])
            left, top = _scaled((x0, y0), full[row], small[row])
            right, bottom = _scaled((x1, y1), full[row], small[row])
            placed[name, row] = left, top, right, bottom
            refuse_box(placed[name, row], small[row].size, full.names[row])
    return placed


def _place_strokes(
    strokes: Strokes, boxes: Mapping[tuple[str, int], Box], full: Cameras, small: Cameras
) -> list[tuple[str, int, Stroke]]:
    """Object's name, row of the view, and stroke in pixels of the working size."""
    placed = []
    for name, places in strokes.items():
        check_name(name)
        several = [places] if places and isinstance(places[0], str) else places
        for place in cast("Sequence[PlacedStroke]", several):
            if len(place) != 2 or not isinstance(place[1], Stroke):
                raise StyleSplatError(
                    f"Cannot use strokes={place!r}. Give the name of a view and a Stroke."
                )
            row, stroke = full.index(place[0]), place[1]
            if (name, row) not in boxes:
                raise StyleSplatError(
                    f"There is a stroke for {name!r} in {full.names[row]}, but no box around it "
                    f"there. Draw one as well: --box {name}={full.names[row]}:x0,y0,x1,y1."
                )
            width, height = full[row].size
            for x, y in stroke.points:
                if not (0 <= x < width and 0 <= y < height):
                    raise StyleSplatError(
                        f"The stroke's point {x:g},{y:g} is outside {full.names[row]}, which is "
                        f"{width}x{height} pixels. Give pixels of the photo."
                    )
            points = tuple(_scaled(point, full[row], small[row]) for point in stroke.points)
            placed.append((name, row, replace(stroke, points=points)))
    return placed


def _scaled(
    point: tuple[float | int, float | int], camera: Cameras, small: Cameras
) -> tuple[float, float]:
    """A point in pixels of the working size."""
    (width, height), (across, down) = camera.size, small.size
    return point[0] * across / width, point[1] * down / height
