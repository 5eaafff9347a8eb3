"""What is left of a scene beside its objects."""

from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.scene import Scene
from stylesplat.selection.identities import object_ids
from stylesplat.selection.pick import THRESHOLD, each_object

WHOLE = frozenset({"all", "background"})  # selections with these are no objects beside others


def rest(
    scene: Scene, name: str | None = None, *, threshold: float = THRESHOLD
) -> Bool[Tensor, " N"]:
    """The Gaussians that belong to no object: those of the label ids, or where there are none,
    those that have a name.

    Args:
        scene: Where they are.
        name: An object that does not count.
        threshold: Probability of an object above which a Gaussian belongs to it.

    Raises:
        StyleSplatError: If there are neither label ids nor names, or nothing is left.
    """
    if scene.splats.classifier is not None:
        ids = object_ids(scene.splats)
        found = each_object(scene.splats, ids, threshold=threshold, remove_outliers=False)
        masks = (picked for _, picked in found)
    else:
        masks = (
            each.picked
            for other, each in scene.objects.items()
            if other != name and not WHOLE & each.how.keys()
        )
    left = None
    for picked in masks:
        left = ~picked if left is None else left & ~picked
    if left is None:
        raise StyleSplatError(
            "The scene has no objects, so all of it is background. Select it with --all, or name "
            "objects first."
        )
    if not left.any():
        raise StyleSplatError("Every Gaussian belongs to an object. Nothing is background.")
    return left
