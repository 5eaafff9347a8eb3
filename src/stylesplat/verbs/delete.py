"""`delete`: a name of a scene taken away."""

from dataclasses import replace

from stylesplat.argument_kinds import check_arguments
from stylesplat.progress import say
from stylesplat.scene.arguments import pasted
from stylesplat.scene.scene import Scene
from stylesplat.selection.objects import require_named


@check_arguments
def delete(scene: Scene, name: str) -> Scene:
    """Forget a named object of a scene. Its Gaussians stay, and so does what is painted on them.

    Args:
        scene: Where it is.
        name: What it is called.

    Raises:
        StyleSplatError: If nothing is called so.

    Example:
        >>> scene = delete(scene, "lid")  # doctest: +SKIP
    """
    require_named(scene, name)
    if name in scene.painted_objects:
        options = ("--object", name, "--undo", "-o", "OTHER")
        way = pasted("adjust", scene.path or "SCENE", *options)
        say(f"{name} stays painted. `{way}` takes that back.")
    objects = {other: each for other, each in scene.objects.items() if other != name}
    return replace(scene, objects=objects)
