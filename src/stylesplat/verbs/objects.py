"""`objects`: what there is in a scene."""

from typing import Any

from jaxtyping import Bool
from torch import Tensor

from stylesplat.argument_kinds import check_arguments
from stylesplat.progress import track
from stylesplat.scene.content import Extent, content_of, extent_of
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import names_of
from stylesplat.selection.identities import object_ids
from stylesplat.selection.pick import each_object
from stylesplat.selection.soft_picks import OwnShares


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
    shares, ids = OwnShares(scene.splats, scene.cameras), object_ids(scene.splats)
    found = each_object(scene.splats, ids)
    return [
        {
            "id": id,
            "names": names_of(scene, id),
            "gaussians": int(mask.sum()),
            "own": int((shares.of(mask) > 0).sum()),
            **_confidence(scene, mask),
            **(_place(extent_of(scene.splats, mask)) if mask.any() else {}),
        }
        for id, mask in track(found, "listing objects", unit="object", total=len(ids))
    ]


def extents(scene: Scene) -> dict[str, Any]:
    """Where a scene's content and all that has a name are, in world units.

    Returns:
        `content`, without what floats around it or lies far behind it, and by name `named`, with
        the number of `gaussians`: `box` along the world's axes, as `select` takes a `box3d`, its
        `centre` and its `size`.
    """
    named = {
        name: {"gaussians": int(each.picked.sum()), **_place(extent_of(scene.splats, each.picked))}
        for name, each in scene.objects.items()
        if each.picked.any()
    }
    return {"content": _place(content_of(scene.splats).extent), "named": named}


def _place(extent: Extent) -> dict[str, list[float]]:
    corners = [*extent.low.tolist(), *extent.high.tolist()]
    parts = {"box": corners, "centre": extent.centre.tolist(), "size": extent.size.tolist()}
    return {what: [float(f"{value:.4g}") for value in values] for what, values in parts.items()}


def _confidence(scene: Scene, mask: Bool[Tensor, " N"]) -> dict[str, float]:
    confidence = scene.splats.confidence
    if confidence is None or not mask.any():
        return {}
    return {"confidence": round(float(confidence[mask].mean()), 3)}
