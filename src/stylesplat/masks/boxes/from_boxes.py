"""`mask --method grabcut`: label maps of objects that the user drew boxes around."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import cast

from stylesplat.errors import StyleSplatError
from stylesplat.masks.boxes.grabcut import Box, Stroke, refuse_box
from stylesplat.masks.boxes.spread import Seen, spread
from stylesplat.masks.foreign import overlaid
from stylesplat.masks.quick_splat import with_maps, with_splat
from stylesplat.scene.arguments import Places, check_box, parse_places
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, at_most
from stylesplat.scene.scene import Scene, check_name

SIZE = 480  # pixels of the longer side at which objects are cut out

SeenStroke = tuple[str, Stroke]
"""A view's name, and a line in pixels of its photo at full size."""
Boxes = Mapping[str, Places]
"""By object's name views, and left, top, right, bottom in pixels of the photo at full size."""
Strokes = Mapping[str, SeenStroke | Sequence[SeenStroke]]
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
    full, small = capture.full_cameras, at_most(capture, SIZE)
    placed = [
        (name, row := full.index(view), _scaled(box, full[row], small.cameras[row]))
        for name, places in boxes.items()
        for view, box in parse_places(places, 4, "boxes")
    ]
    _refuse_twice(placed, full.names)
    drawn = [
        (name, row := full.index(view), _scaled_stroke(stroke, full[row], small.cameras[row]))
        for name, view, stroke in _each_stroke(strokes)
    ]
    _refuse_alone(drawn, placed, full.names)
    working = with_splat(small, scene, device)
    cameras, seen = working.capture.cameras, Seen(working.splats, working.capture)
    names = dict(enumerate(boxes, start=1))
    masks = {}
    for id, name in names.items():
        around = [(row, box) for each, row, box in placed if each == name]
        over = [(row, stroke) for each, row, stroke in drawn if each == name]
        masks[id] = spread(working.splats, cameras, seen, around, over, name=name)
    maps = [
        partial(overlaid, [(id, found[row]) for id, found in masks.items()])
        for row in range(len(capture))
    ]
    return with_maps(capture, maps, names)


def refuse_without_box(boxes: Boxes) -> None:
    """Refuse to cut out what no box is around, before the photos are looked at.

    Raises:
        StyleSplatError: If there is no box, or an object cannot be called so.
    """
    if not boxes or not all(boxes.values()):
        raise StyleSplatError(
            "Nothing says what to mask. Draw a box around an object, --box NAME=VIEW:x0,y0,x1,y1; "
            "find all objects with a model, --method sam2; or take another program's masks, --from."
        )
    for name in boxes:
        check_name(name)


def _each_stroke(strokes: Strokes) -> Iterator[tuple[str, str, Stroke]]:
    """An object's name, a view's, and what was drawn there."""
    for name, places in strokes.items():
        check_name(name)
        several = [places] if places and isinstance(places[0], str) else places
        for place in cast("Sequence[SeenStroke]", several):
            if len(place) != 2 or not isinstance(place[1], Stroke):
                raise StyleSplatError(
                    f"Cannot use strokes={place!r}. Give the name of a view and a Stroke."
                )
            yield name, *place


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


def _scaled_stroke(stroke: Stroke, camera: Cameras, small: Cameras) -> Stroke:
    """A stroke in the pixels of the working size; raises a StyleSplatError if it is outside."""
    (width, height), (name,) = camera.size, camera.names
    for x, y in stroke.points:
        if not (0 <= x < width and 0 <= y < height):
            raise StyleSplatError(
                f"The stroke's point {x:g},{y:g} is outside {name}, which is {width}x{height} "
                "pixels. Give pixels of the photo."
            )
    across, down = _shrinkage(camera, small)
    points = tuple((x * across, y * down) for x, y in stroke.points)
    return replace(stroke, points=points)


def _scaled(box: Box, camera: Cameras, small: Cameras) -> Box:
    """A box in the pixels of the working size; raises a StyleSplatError if it is none."""
    (name,) = camera.names
    x0, y0, x1, y1 = check_box(box, camera.size, name)
    across, down = _shrinkage(camera, small)
    scaled = (x0 * across, y0 * down, x1 * across, y1 * down)
    refuse_box(scaled, small.size, name)
    return scaled


def _shrinkage(camera: Cameras, small: Cameras) -> tuple[float, float]:
    """How many times smaller the working size is, across and down."""
    (width, height), (across, down) = camera.size, small.size
    return across / width, down / height
