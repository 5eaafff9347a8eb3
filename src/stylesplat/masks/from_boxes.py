"""`mask --method grabcut`: label maps of objects that the user drew boxes around."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import cast

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.label_maps import overlay_masks
from stylesplat.masks.box_propagation import propagate_boxes, propagate_marks, view_images
from stylesplat.masks.grabcut import DrawnBox, Stroke, pixels_inside, refuse_box
from stylesplat.masks.working_splat import with_label_maps, working_splat
from stylesplat.options import BOX, Places, check_box
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import (
    BACKGROUND,
    Capture,
    Mask,
    OwnLabels,
    at_most,
    ids_of,
    resize_labels,
)
from stylesplat.scene.objects import check_name
from stylesplat.scene.scene import Scene

DRAWN_BOX_SIZE = 480  # pixels of the longer side at which objects are cut out
ANY = "object"  # the name of what is given none

PlacedStroke = tuple[str, Stroke]
"""A view's name, and a line in pixels of its photo at full size."""
Boxes = Mapping[str, Places]
"""By object's name views, and left, top, right, bottom in pixels of the photo at full size."""
Strokes = Mapping[str, PlacedStroke | Sequence[PlacedStroke]]
"""By object's name."""


@dataclass(frozen=True, eq=False)
class FromBoxes:
    """Label maps of what the user drew boxes around in one or a few photos, without any model.

    Without boxes around objects the label maps of the capture are corrected.
    """

    boxes: Boxes = field(default_factory=dict)
    strokes: Strokes = field(default_factory=dict)
    keep: Boxes = field(default_factory=dict)
    drop: Boxes = field(default_factory=dict)
    scene: Scene | None = None

    def __post_init__(self) -> None:
        if self.boxes or not (self.strokes or self.keep or self.drop):
            refuse_without_box(self.boxes)

    def mask(self, capture: Capture, device: str) -> Capture:
        """Cut the objects out of all photos."""
        boxes = self.boxes
        small, full = at_most(capture, DRAWN_BOX_SIZE), capture.full_cameras
        named = dict(enumerate(boxes, start=1)) if boxes else dict(capture.object_names)
        names = named if boxes else _names_in(capture)
        if not names:
            refuse_without_box({})
        around = _place_boxes(boxes, full, small.cameras)
        over = _place_strokes(self.strokes, [*names.values()], full, small.cameras)
        marks = _marks(over, self.keep, self.drop, names, full, small.cameras)
        working = working_splat(small, self.scene, device)
        cameras, images = working.capture.cameras, view_images(working.splats, working.capture)
        masks = {
            id: propagate_boxes(
                working.splats,
                cameras,
                images,
                [(row, box) for (each, row), box in around.items() if each == name],
                marks.get(name, ()),
                name=name,
            )
            for id, name in names.items()
            if boxes
        }
        changes = {
            id: propagate_marks(working.splats, cameras, marks[name])
            for id, name in names.items()
            if name in marks
        }

        def labels(row: int) -> OwnLabels:
            found = capture.labels(row)
            if boxes:
                found = overlay_masks([(id, each[row]) for id, each in masks.items()])
            elif found is None:
                found = torch.zeros(*capture.cameras[row].size[::-1], dtype=torch.int32)
            found = found.clone()
            for id, each in changes.items():
                kept, dropped = (resize_labels(m.int(), found.shape).bool() for m in each[row])
                found[dropped & (found == id)] = BACKGROUND
                found[kept] = id
            return found

        maps = [partial(labels, row) for row in range(len(capture))]
        return with_label_maps(capture, maps, named)


def _names_in(capture: Capture) -> dict[int, str]:
    """The objects that label maps show: their names, or their ids where they have none."""
    maps = (capture.labels(row) for row in range(len(capture)))
    shown = set[int]().union(*(ids_of(each) for each in maps if each is not None))
    return {id: capture.object_names.get(id, str(id)) for id in sorted(shown - {BACKGROUND})}


def refuse_without_box(boxes: Boxes) -> None:
    """Raise a StyleSplatError if there is no box, or an object cannot be called so."""
    if not boxes or not all(boxes.values()):
        raise StyleSplatError(
            "Nothing says what to mask. Draw a box around an object, --box NAME=VIEW:x0,y0,x1,y1; "
            "find all objects with a model, --method sam2; or take another program's masks, --from."
        )
    for name in boxes:
        check_name(name)


def _place_boxes(boxes: Boxes, full: Cameras, small: Cameras) -> dict[tuple[str, int], DrawnBox]:
    """Boxes in pixels of the working size, by object's name and row of the view."""
    placed: dict[tuple[str, int], DrawnBox] = {}
    for name, places in boxes.items():
        for view, box in BOX.parse_all(places, "boxes"):
            row = full.index(view)
            if (name, row) in placed:
                raise StyleSplatError(
                    f"There are several boxes around {name!r} in {full.names[row]}. Draw one "
                    "around all of it, or give them different names."
                )
            box = check_box(box, full[row].size, full.names[row])
            placed[name, row] = _scaled_box(box, full[row], small[row])
            refuse_box(placed[name, row], small[row].size, full.names[row])
    return placed


def _marks(
    strokes: Sequence[tuple[str, int, Stroke]],
    keep: Boxes,
    drop: Boxes,
    names: Mapping[int, str],
    full: Cameras,
    small: Cameras,
) -> dict[str, list[tuple[int, Mask, Mask]]]:
    """By object's name rows of views, and their pixels that belong to it, and that do not."""
    found: dict[tuple[str, int], tuple[Mask, Mask]] = {}

    def add(name: str, row: int, pixels: Mask, belongs: bool) -> None:
        before = found.setdefault((name, row), (torch.zeros_like(pixels), torch.zeros_like(pixels)))
        before[not belongs][pixels] = True

    for name, row, stroke in strokes:
        add(name, row, stroke.pixels(small[row].size), stroke.over_object)
    for boxes, belongs in ((keep, True), (drop, False)):
        for name, places in boxes.items():
            own = _known_name(name, [*names.values()])
            for view, box in BOX.parse_all(places, "keep" if belongs else "drop"):
                row = full.index(view)
                scaled = _scaled_box(check_box(box, full[row].size, view), full[row], small[row])
                pixels = torch.from_numpy(pixels_inside(scaled, small[row].size))
                if not pixels.any():
                    raise StyleSplatError(f"The box in {view} is too small. Draw a larger one.")
                add(own, row, pixels, belongs)
    marks: dict[str, list[tuple[int, Mask, Mask]]] = {}
    for (name, row), masks in found.items():
        marks.setdefault(name, []).append((row, *masks))
    return marks


def _known_name(name: str, known: Sequence[str]) -> str:
    """The name of an object that a mark is for; the only one where none was given."""
    if name in known:
        return name
    if name == ANY and len(known) == 1:
        return known[0]
    raise StyleSplatError(
        f"No object is called {name!r} (there are: {', '.join(known) or 'none'}). Write NAME=VIEW:"
        "... with one of these, or draw a --box around another."
    )


def _place_strokes(
    strokes: Strokes, names: Sequence[str], full: Cameras, small: Cameras
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
            width, height = full[row].size
            for x, y in stroke.points:
                if not (0 <= x < width and 0 <= y < height):
                    raise StyleSplatError(
                        f"The stroke's point {x:g},{y:g} is outside {full.names[row]}, which is "
                        f"{width}x{height} pixels. Give pixels of the photo."
                    )
            points = tuple(_scaled(point, full[row], small[row]) for point in stroke.points)
            placed.append((_known_name(name, names), row, replace(stroke, points=points)))
    return placed


def _scaled_box(box: DrawnBox, camera: Cameras, small: Cameras) -> DrawnBox:
    return *_scaled(box[:2], camera, small), *_scaled(box[2:], camera, small)


def _scaled(
    point: tuple[float | int, float | int], camera: Cameras, small: Cameras
) -> tuple[float, float]:
    """A point in pixels of the working size."""
    (width, height), (across, down) = camera.size, small.size
    return point[0] * across / width, point[1] * down / height
