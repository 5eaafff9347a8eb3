"""`objects` and `select`: what is in a scene, and which Gaussians of it are meant."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.sheet import object_sheet
from stylesplat.io.images import write_image
from stylesplat.io.scene_folder import Scene, read_scene, update_scene
from stylesplat.selection.labels import object_ids
from stylesplat.selection.pick import Box, Point, pick_objects, resolve_ids, select

SHEET = "objects.png"


def list_objects(path: Path) -> dict[str, Any]:
    """The objects of a scene with their Gaussian counts; writes a contact sheet of them.

    Returns:
        `objects`: id, names and Gaussians of each; `sheet`: the picture's path.

    Raises:
        StyleSplatError: If the folder is no scene or has no identities.
    """
    scene = read_scene(path)
    picked = pick_objects(scene.splats, object_ids(scene.splats))
    names = {id: _names_of(scene, id) for id in picked}
    sheet = object_sheet(
        scene.splats,
        scene.cameras,
        names={id: ", ".join(called) for id, called in names.items() if called},
    )
    write_image(sheet, path / SHEET)
    objects = [
        {"id": id, "names": names[id], "gaussians": int(mask.sum())} for id, mask in picked.items()
    ]
    return {"objects": objects, "sheet": path / SHEET}


def select_object(
    path: Path,
    name: str,
    *,
    ids: Sequence[int] = (),
    box: tuple[str, Box] | None = None,
    point: tuple[str, Point] | None = None,
    threshold: float,
    remove_outliers: bool = True,
) -> dict[str, Any]:
    """Name some Gaussians of a scene: by label ids, by a box or by a point in a view.

    Returns:
        `name`, `ids` and `gaussians`.

    Raises:
        StyleSplatError: If the scene has no such object, or the name would be mistaken for an id.
    """
    if name.isdecimal() or not name or "=" in name:
        raise StyleSplatError(
            f"Cannot call an object {name!r}: names must not be numbers, empty or contain '='."
        )
    scene = read_scene(path)
    view = box or point
    found = resolve_ids(
        scene.splats,
        object_id=ids or None,
        box=box[1] if box else None,
        point=point[1] if point else None,
        camera=scene.cameras[scene.cameras.index(view[0])] if view else None,
    )
    mask = select(
        scene.splats, object_id=found, threshold=threshold, remove_outliers=remove_outliers
    )
    how = {"ids": list(found), "threshold": threshold, "gaussians": int(mask.sum())}
    if view:
        how |= {"view": view[0], "box" if box else "point": list(view[1])}
    update_scene(path, picks=scene.picks | {name: mask}, objects=scene.objects | {name: how})
    return {"name": name, **how}


def find_object(scene: Scene, name: str) -> Bool[Tensor, " N"]:
    """The Gaussians that a name or a label id means.

    Raises:
        StyleSplatError: If the scene knows neither.
    """
    if name in scene.picks:
        return scene.picks[name]
    if name.isdecimal() and scene.splats.classifier is not None:
        return select(scene.splats, object_id=int(name))
    known = ", ".join(scene.picks) or "none"
    raise StyleSplatError(
        f"The scene has no object {name!r}. Named objects: {known}. "
        "Name one with `stylesplat select SCENE --name NAME --id N`."
    )


def _names_of(scene: Scene, id: int) -> list[str]:
    return [name for name, how in scene.objects.items() if how.get("ids") == [id]]
