"""Objects of a scene called what their label maps call them."""

from collections.abc import Mapping

from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief
from stylesplat.progress import say
from stylesplat.scene.scene import Scene, SceneObject, name_fault
from stylesplat.selection.identities import object_ids
from stylesplat.selection.pick import THRESHOLD, pick_objects


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
    for id, mask in picked.items():
        name = known[id]
        fault = _fault(scene, name, mask)
        if fault:
            say(
                f"Object {id} is not called {brief(name)!r}: {fault}. `stylesplat select` names it."
            )
            continue
        how = {"ids": [id], "threshold": THRESHOLD, "gaussians": int(mask.sum())}
        scene = scene.with_object(name, SceneObject(mask, how))
    return scene


def require_named(scene: Scene, name: str) -> SceneObject:
    """The object that has a name.

    Raises:
        StyleSplatError: If none has.
    """
    if name in scene.objects:
        return scene.objects[name]
    known = ", ".join(scene.objects) or "none"
    raise StyleSplatError(
        f"No object of {scene.path or 'the scene'} is called {brief(name)!r}. Names: {known}. "
        "Objects get names by `stylesplat select`."
    )


def _fault(scene: Scene, name: str, mask: Bool[Tensor, " N"]) -> str | None:
    if not mask.any():
        return "no Gaussians are it"
    return "another object is" if name in scene.objects else name_fault(name)
