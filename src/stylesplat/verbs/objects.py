"""`objects`: what there is in a scene."""

from typing import Any

from jaxtyping import Bool
from torch import Tensor

from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import names_of
from stylesplat.selection.identities import object_ids
from stylesplat.selection.pick import pick_objects


def objects(scene: Scene) -> list[dict[str, Any]]:
    """List the objects that a scene's label maps named.

    Returns:
        By id: `id`, `names`, `gaussians`, and if labels were lifted the mean `confidence` of
        these.

    Raises:
        StyleSplatError: If the scene has no identities.
    """
    picked = pick_objects(scene.splats, object_ids(scene.splats))
    return [
        {
            "id": id,
            "names": names_of(scene, id),
            "gaussians": int(mask.sum()),
            **_confidence(scene, mask),
        }
        for id, mask in picked.items()
    ]


def _confidence(scene: Scene, mask: Bool[Tensor, " N"]) -> dict[str, float]:
    confidence = scene.splats.confidence
    if confidence is None or not mask.any():
        return {}
    return {"confidence": round(float(confidence[mask].mean()), 3)}
