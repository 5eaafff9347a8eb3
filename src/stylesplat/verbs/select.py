"""`select`: name some Gaussians of a scene."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.selection_picture import selection_picture
from stylesplat.io.files import file_stem
from stylesplat.io.images import write_image
from stylesplat.io.scene_folder import Scene, read_scene, update_scene
from stylesplat.scene.cameras import Cameras
from stylesplat.selection.margins import grow, shrink
from stylesplat.selection.pick import THRESHOLD, Box, Point, pick_objects, resolve_ids, select
from stylesplat.selection.shapes import in_box, in_sphere, surface_point
from stylesplat.verbs.objects import can_be_called, find_object
from stylesplat.verbs.say import say

PICTURES = "selections"  # the folder inside a scene


@dataclass(frozen=True)
class Choice:
    """Which Gaussians are meant: all that is named, less what is taken away."""

    ids: tuple[int, ...] = ()
    """Label ids."""
    boxes: tuple[tuple[str, Box], ...] = ()
    """A view and a rectangle of its pixels: the object that shows most inside."""
    points: tuple[tuple[str, Point], ...] = ()
    """A view and a pixel: the object that shows there."""
    not_points: tuple[tuple[str, Point], ...] = ()
    """Objects that are not meant."""
    box3d: tuple[float, ...] = ()
    """Two corners in the world, the lower one first."""
    sphere: tuple[str, tuple[float, ...]] | None = None
    """A centre in the world and a radius; or a view, the pixel that shows the centre, a radius."""
    plus: tuple[str, ...] = ()
    """Earlier names that are part of it."""
    minus: tuple[str, ...] = ()
    """Earlier names that are not."""
    grow: float | None = None
    """Share of its extent by which to grow what was chosen by all that is above."""
    shrink: float | None = None
    """Share of its extent by which to shrink it."""


def select_object(
    path: Path,
    name: str,
    choice: Choice,
    *,
    threshold: float = THRESHOLD,
    remove_outliers: bool = True,
) -> dict[str, Any]:
    """Name some Gaussians of a scene, and draw them in three views.

    Returns:
        `name`, `ids`, `gaussians`, and how they were chosen; `picture`: the drawing's path, None
        if they show in no view.

    Raises:
        StyleSplatError: If the scene has no such object, nothing is left, the name would be
            mistaken for an id, or it is to grow and to shrink.
    """
    if not can_be_called(name):
        raise StyleSplatError(
            f"Cannot call an object {name!r}: names must not be numbers, empty or contain '='."
        )
    if choice.grow is not None and choice.shrink is not None:
        raise StyleSplatError("An object cannot grow and shrink. Pass --grow or --shrink.")
    scene = read_scene(path)
    without = _ids_at(scene, choice.not_points)
    ids = tuple(id for id in _ids(scene, choice) if id not in without)
    masks = [*_shapes(scene, choice), *(find_object(scene, each) for each in choice.plus)]
    if ids:
        picked = select(
            scene.splats, object_id=ids, threshold=threshold, remove_outliers=remove_outliers
        )
        masks.append(picked)
    if not masks:
        raise StyleSplatError(
            f"Nothing to call {name!r}. Say what with --id, --point, --box, --box3d, --sphere or "
            "--plus; --not-point only takes away."
        )
    mask = torch.stack(masks).any(dim=0)
    taken = [find_object(scene, each) for each in choice.minus]
    taken += pick_objects(scene.splats, without, threshold=threshold).values() if without else []
    for each in taken:
        mask &= ~each
    if not mask.any():
        raise StyleSplatError(f"Nothing is left of {name!r}. Take away less.")
    mask = _resized(scene, mask, choice)
    said = {key: value for key, value in asdict(choice).items() if value and key != "ids"}
    how = {"ids": list(ids), "threshold": threshold, "gaussians": int(mask.sum()), **said}
    update_scene(path, picks=scene.picks | {name: mask}, objects=scene.objects | {name: how})
    return {"name": name, **how, "picture": _draw(scene, path, name, mask)}


def _ids(scene: Scene, choice: Choice) -> tuple[int, ...]:
    """The label ids that are named or pointed at, each once."""
    found = list(resolve_ids(scene.splats, object_id=choice.ids)) if choice.ids else []
    for view, box in choice.boxes:
        found += resolve_ids(scene.splats, box=box, camera=_camera(scene, view))
    return tuple(dict.fromkeys([*found, *_ids_at(scene, choice.points)]))


def _ids_at(scene: Scene, points: Sequence[tuple[str, Point]]) -> list[int]:
    return [
        id
        for view, point in points
        for id in resolve_ids(scene.splats, point=point, camera=_camera(scene, view))
    ]


def _shapes(scene: Scene, choice: Choice) -> Iterator[Bool[Tensor, " N"]]:
    splats = scene.splats
    if choice.box3d:
        low, high = torch.tensor(choice.box3d).view(2, 3)
        yield in_box(splats, low, high)
    if choice.sphere:
        view, (*place, radius) = choice.sphere
        if view:
            x, y = place
            centre = surface_point(splats, _camera(scene, view), (x, y))
        else:
            centre = torch.tensor(place)
        yield in_sphere(splats, centre, radius)


def _draw(scene: Scene, path: Path, name: str, mask: Bool[Tensor, " N"]) -> Path | None:
    target = path / PICTURES / f"{file_stem(name)}.png"
    picture = selection_picture(scene.splats, scene.cameras, mask)
    if picture is None:
        say(f"{name} shows in none of the views, so there is no picture of it.")
        target.unlink(missing_ok=True)
        return None
    write_image(picture, target)
    return target


def _resized(scene: Scene, mask: Bool[Tensor, " N"], choice: Choice) -> Bool[Tensor, " N"]:
    if choice.grow is not None:
        return grow(scene.splats, mask, choice.grow)
    return mask if choice.shrink is None else shrink(scene.splats, mask, choice.shrink)


def _camera(scene: Scene, view: str) -> Cameras:
    return scene.cameras[scene.cameras.index(view)]
