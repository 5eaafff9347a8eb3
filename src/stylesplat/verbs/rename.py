"""`rename`: another name for an object of a scene."""

from dataclasses import replace

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError, brief
from stylesplat.scene.scene import Scene, check_name
from stylesplat.selection.objects import require_named


@check_arguments
def rename(scene: Scene, old: str, new: str) -> Scene:
    """Call an object of a scene, and its layer of paint, something else.

    Args:
        scene: Where it is.
        old: What it is called.
        new: What to call it.

    Raises:
        StyleSplatError: If nothing is called so, or the new name is taken or cannot be one.

    Example:
        >>> scene = rename(scene, "object", "vase")  # doctest: +SKIP
    """
    require_named(scene, old)
    check_name(new)
    if new == old:
        raise StyleSplatError(f"{brief(old)!r} is called so already. Choose another name.")
    if new in scene.objects or new in scene.painted_objects:
        raise StyleSplatError(
            f"Cannot rename {old!r}: something else is called {new!r}. Choose another name, or "
            f"delete that one first."
        )
    objects = {new if name == old else name: each for name, each in scene.objects.items()}
    layers = tuple(
        replace(each, object=new) if each.object == old else each for each in scene.layers
    )
    return replace(scene, objects=objects, layers=layers if scene.layers else scene.layers)
