"""`objects`: what is in a scene, and which Gaussians a name means."""

from pathlib import Path
from typing import Any

from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.evaluation.sheet import object_sheet
from stylesplat.io.images import write_image
from stylesplat.io.scene_folder import Scene, read_scene
from stylesplat.selection.labels import object_ids
from stylesplat.selection.pick import pick_objects, select

SHEET = "objects.png"
SHAPING = {"plus", "minus", "box3d", "sphere"}  # selections with these are not the whole object


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
    return [
        name
        for name, how in scene.objects.items()
        if how.get("ids") == [id] and not SHAPING & how.keys()
    ]
