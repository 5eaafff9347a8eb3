"""`rename`: another name for an object of a scene."""

from dataclasses import replace

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError, brief
from stylesplat.scene.pasted import pasted
from stylesplat.scene.scene import Scene, check_name
from stylesplat.selection.naming import require_named


@check_arguments
def rename(scene: Scene, old: str, new: str) -> Scene:
    """Call an object of a scene something else.

    Args:
        scene: Where it is.
        old: What it is called.
        new: What to call it.

    Raises:
        StyleSplatError: If nothing is called so, the new name is taken or cannot be one, or the
            object is painted: the recipe, by which the scene can be made again, has its name.

    Example:
        >>> scene = rename(scene, "object", "vase")  # doctest: +SKIP
    """
    require_named(scene, old)
    check_name(new)
    if new == old:
        raise StyleSplatError(f"{brief(old)!r} is called so already. Choose another name.")
    painted = scene.painted.names if scene.painted else ()
    if old in painted:
        options = ("--object", old, "--undo", "-o", "SCENE")
        way = pasted("adjust", scene.path or "STYLED", *options)
        raise StyleSplatError(
            f"Cannot rename {old!r}: it is painted, and the recipe calls it so. Rename it in the "
            f"scene before, or take the paint back first: `{way}`."
        )
    if new in scene.objects or new in painted:
        raise StyleSplatError(
            f"Cannot rename {old!r}: something else is called {new!r}. Choose another name, or "
            f"delete that one first."
        )
    objects = {new if name == old else name: each for name, each in scene.objects.items()}
    return replace(scene, objects=objects)
