"""`objects`: what is in a scene, and which Gaussians a name means."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxtyping import Bool
from torch import Tensor

from stylesplat.drawing.object_sheet import object_sheet
from stylesplat.errors import StyleSplatError
from stylesplat.io.images import write_image
from stylesplat.io.scene_folder import Scene, read_scene
from stylesplat.progress import say
from stylesplat.selection.identities import object_ids
from stylesplat.selection.pick import THRESHOLD, pick_objects, select

SHEET = "objects.png"
# Selections with these are not the whole object
SHAPING = {"plus", "minus", "box3d", "sphere", "grow", "shrink"}


def list_objects(path: Path) -> dict[str, Any]:
    """The objects of a scene with their Gaussian counts; writes a contact sheet of them.

    Returns:
        `objects`: id, names and Gaussians of each, and if labels were lifted the mean
        `confidence` of these; `sheet`: the picture's path.

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
        {"id": id, "names": names[id], "gaussians": int(mask.sum()), **_confidence(scene, mask)}
        for id, mask in picked.items()
    ]
    return {"objects": objects, "sheet": path / SHEET}


def with_names(scene: Scene, names: Mapping[int, str]) -> Scene:
    """A scene in which objects are called what their label maps call them.

    Args:
        scene: With identities if anything is to be named.
        names: By label id. What no Gaussian belongs to, or cannot be a name, or is that of an
            object before, stays unnamed.
    """
    ids = object_ids(scene.splats) if scene.splats.classifier else ()
    known = {id: name for id, name in names.items() if id in ids}
    picked = pick_objects(scene.splats, [*known]) if known else {}
    picks, objects = dict(scene.picks), dict(scene.objects)
    for id, mask in picked.items():
        name = known[id]
        if not mask.any() or not can_be_called(name) or name in picks:
            say(f"Object {id} is not called {name!r}. `stylesplat select` names it.")
            continue
        picks[name] = mask
        objects[name] = {"ids": [id], "threshold": THRESHOLD, "gaussians": int(mask.sum())}
    return replace(scene, picks=picks, objects=objects)


def can_be_called(name: str) -> bool:
    """Whether a name is one: neither empty, nor like an id, nor in the way of `OBJECT=IMAGE`."""
    return bool(name) and not name.isdecimal() and "=" not in name


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


def _confidence(scene: Scene, mask: Bool[Tensor, " N"]) -> dict[str, float]:
    confidence = scene.splats.confidence
    if confidence is None or not mask.any():
        return {}
    return {"confidence": round(float(confidence[mask].mean()), 3)}


def _names_of(scene: Scene, id: int) -> list[str]:
    return [
        name
        for name, how in scene.objects.items()
        if how.get("ids") == [id] and not SHAPING & how.keys()
    ]
