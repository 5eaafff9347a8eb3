"""`select`: name some Gaussians of a scene."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.drawing.selection_picture import selection_picture
from stylesplat.errors import StyleSplatError
from stylesplat.io.files import file_stem
from stylesplat.io.images import write_image
from stylesplat.io.scene_folder import Scene, read_scene, update_scene
from stylesplat.progress import say
from stylesplat.rendering.device import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.selection.detector import load_detector
from stylesplat.selection.identities import object_ids
from stylesplat.selection.margins import grow, shrink
from stylesplat.selection.pick import THRESHOLD, Box, Point, pick_objects, resolve_ids, select
from stylesplat.selection.shapes import in_box, in_sphere, surface_point
from stylesplat.selection.text import clear_winner, rank_objects
from stylesplat.verbs.objects import can_be_called, find_object

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
    text: str | None = None
    """A few words: the object that they mean."""
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
    model: str | None = None,
) -> dict[str, Any]:
    """Name some Gaussians of a scene, and draw them in three views.

    Args:
        path: The scene.
        name: What to call them.
        choice: Which.
        threshold: Probability of an object above which a Gaussian belongs to it.
        remove_outliers: Whether to drop Gaussians that lie apart from the rest of an object.
        model: Folder or name of the detector that finds `choice.text`.

    Returns:
        `name`, `ids`, `gaussians`, and how they were chosen; for a text the `scores` of the
        objects that it may mean, by id; `picture`: the drawing's path, None if they show in no
        view.

    Raises:
        StyleSplatError: If the scene has no such object, the text means none or several, nothing
            is left, the name would be mistaken for an id, or it is to grow and to shrink.
    """
    if not can_be_called(name):
        raise StyleSplatError(
            f"Cannot call an object {name!r}: names must not be numbers, empty or contain '='."
        )
    if choice.grow is not None and choice.shrink is not None:
        raise StyleSplatError("An object cannot grow and shrink. Pass --grow or --shrink.")
    scene = read_scene(path)
    without = _ids_at(scene, choice.not_points)
    masks = [*_shapes(scene, choice), *(find_object(scene, each) for each in choice.plus)]
    named, scores = _ids(scene, choice), {}
    if choice.text is not None:
        scores = _scores(scene, choice.text, model, without)
        named += (_winner(scene, scores, choice.text),)
    ids = tuple(id for id in dict.fromkeys(named) if id not in without)
    if ids:
        picked = select(
            scene.splats, object_id=ids, threshold=threshold, remove_outliers=remove_outliers
        )
        masks.append(picked)
    if not masks:
        raise StyleSplatError(
            f"Nothing to call {name!r}. Say what with --id, --point, --box, --text, --box3d, "
            "--sphere or --plus; --not-point only takes away."
        )
    mask = torch.stack(masks).any(dim=0)
    for each in _taken_away(scene, choice, without, threshold):
        mask &= ~each
    if not mask.any():
        raise StyleSplatError(f"Nothing is left of {name!r}. Take away less.")
    mask = _resized(scene, mask, choice)
    said = {key: value for key, value in asdict(choice).items() if value and key != "ids"}
    how = {"ids": list(ids), "threshold": threshold, "gaussians": int(mask.sum()), **said}
    how |= {"scores": scores} if scores else {}
    if name in scene.picks:
        say(f"{name!r} meant {int(scene.picks[name].sum()):,} Gaussians before.")
    update_scene(path, picks=scene.picks | {name: mask}, objects=scene.objects | {name: how})
    return {"name": name, **how, "picture": _draw(scene, path, name, mask)}


def _taken_away(
    scene: Scene, choice: Choice, without: Sequence[int], threshold: float
) -> Iterator[Bool[Tensor, " N"]]:
    """Gaussians that are not meant, with their strays."""
    for name in choice.minus:
        yield find_object(scene, name)
    if without:
        splats = scene.splats
        yield from pick_objects(
            splats, without, threshold=threshold, remove_outliers=False
        ).values()


def _winner(scene: Scene, scores: dict[int, float], text: str) -> int:
    called = {id: name for name, how in scene.objects.items() for id in how.get("ids", [])}
    return clear_winner(scores, text, called)


def _ids(scene: Scene, choice: Choice) -> tuple[int, ...]:
    """The label ids that are named or pointed at."""
    found = list(resolve_ids(scene.splats, object_id=choice.ids)) if choice.ids else []
    for view, box in choice.boxes:
        found += resolve_ids(scene.splats, box=box, camera=_camera(scene, view))
    return (*found, *_ids_at(scene, choice.points))


def _ids_at(scene: Scene, points: Sequence[tuple[str, Point]]) -> list[int]:
    return [
        id
        for view, point in points
        for id in resolve_ids(scene.splats, point=point, camera=_camera(scene, view))
    ]


def _scores(scene: Scene, text: str, model: str | None, without: Sequence[int]) -> dict[int, float]:
    """How well a text fits each object that may be meant, as it looks without a style."""
    object_ids(scene.splats)  # refuses splats without objects before a model is downloaded
    if not text.strip():
        raise StyleSplatError("The text is empty. Say what to find, such as --text 'red chair'.")
    device = pick_device()
    splats = replace(scene.splats, **(scene.base_colors or {})).to(device)
    ranking = rank_objects(splats, scene.cameras, text, load_detector(model, device))
    return {id: score for id, score in ranking.items() if id not in without}


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
