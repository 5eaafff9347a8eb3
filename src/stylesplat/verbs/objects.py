"""`objects`, `rename` and `delete`: what there is in a scene, and what it is called."""

from dataclasses import replace
from typing import Any

from jaxtyping import Bool
from msgspec import structs
from torch import Tensor

from stylesplat.errors import StyleSplatError, shell_command, shorten
from stylesplat.options import check_arguments
from stylesplat.progress import say, track
from stylesplat.scene.content import Extent, content_of, extent_of
from stylesplat.scene.objects import check_name
from stylesplat.scene.scene import Scene
from stylesplat.scene.world_offset import Offset, to_world
from stylesplat.selection.labels import each_object, object_ids
from stylesplat.selection.objects import require_named
from stylesplat.selection.resolve import names_of
from stylesplat.selection.shares import OWN_SHARE, OwnShares


@check_arguments
def objects(scene: Scene) -> list[dict[str, Any]]:
    """List the objects that a scene's label maps named.

    Returns:
        By id: `id`, `names`, `gaussians`, how many of these are the object's `own`, which
        `stylize` paints, if labels were lifted their mean `confidence`, and as `extents` gives it
        where they are.

    Raises:
        StyleSplatError: If the scene has no identities.
    """
    shares, ids = OwnShares(scene.base, scene.cameras), object_ids(scene.base)
    found = each_object(scene.base, ids)
    return [
        {
            "id": id,
            "names": names_of(scene, id),
            "gaussians": int(mask.sum()),
            "own": int((shares.of(mask) > OWN_SHARE).sum()),
            **(_details(scene, mask) if mask.any() else {}),
        }
        for id, mask in track(found, "listing objects", unit="object", total=len(ids))
    ]


def extents(scene: Scene) -> dict[str, Any]:
    """The extents in world units of a scene's content and of its named objects.

    Returns `content`, without floaters and far background, and `named` by name, with the number of
    `gaussians`: `box` along the world's axes as in `select`, its `centre` and its `size`.
    """
    named = {
        name: {"gaussians": int(each.mask.sum()), **_place(scene, each.mask)}
        for name, each in scene.objects.items()
        if each.mask.any()
    }
    content = content_of(scene.splats).extent
    return {"content": _in_world(content, scene.world_offset), "named": named}


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
        raise StyleSplatError(f"{shorten(old)!r} is called so already. Choose another name.")
    if new in scene.objects or new in scene.painted_objects:
        raise StyleSplatError(
            f"Cannot rename {old!r}: something else is called {new!r}. Choose another name, or "
            f"delete that one first."
        )
    objects = {new if name == old else name: each for name, each in scene.objects.items()}
    for name, each in objects.items():
        if each.selection.of == old:
            objects[name] = replace(each, selection=structs.replace(each.selection, of=new))
    layers = []
    for each in scene.layers:
        protect = [new if name == old else name for name in each.settings.get("protect", ())]
        settings = {**each.settings, **({"protect": protect} if protect else {})}
        own = new if each.object == old else each.object
        layers.append(replace(each, object=own, settings=settings))
    return replace(scene, objects=objects, layers=tuple(layers))


@check_arguments
def delete(scene: Scene, name: str) -> Scene:
    """Forget a named object of a scene. Its Gaussians stay, and so does what is painted on them.

    Those of a part belong to the object again that it is a part of.

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
        way = shell_command("adjust", scene.path or "SCENE", *options)
        say(f"{name} stays painted. `{way}` takes that back.")
    part, objects = scene.objects[name], dict(scene.objects)
    del objects[name]
    if (of := part.selection.of) in objects:
        objects[of] = replace(objects[of], mask=objects[of].mask | part.mask)
    return replace(scene, objects=objects)


def _details(scene: Scene, mask: Bool[Tensor, " B"]) -> dict[str, Any]:
    """The mean confidence, if labels were lifted, and the place of an object."""
    place, confidence = _place(scene, mask), scene.base.confidence
    if confidence is None:
        return place
    return {"confidence": round(float(confidence[mask].mean()), 3), **place}


def _place(scene: Scene, mask: Bool[Tensor, " B"]) -> dict[str, list[float]]:
    return _in_world(extent_of(scene.base, mask), scene.world_offset)


def _in_world(extent: Extent, offset: Offset) -> dict[str, list[float]]:
    """A box in the world, in four digits besides those of the world's offset."""

    def rounded(values: Tensor) -> Tensor:
        return values.double().apply_(lambda value: float(f"{value:.4g}"))

    corners = (extent.low, extent.high, extent.centre)
    low, high, centre = (to_world(rounded(corner), offset).tolist() for corner in corners)
    return {"box": [*low, *high], "centre": centre, "size": rounded(extent.size).tolist()}
