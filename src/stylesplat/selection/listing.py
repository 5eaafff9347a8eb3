"""The objects of a scene as lists of Gaussians."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import track
from stylesplat.scene.compose import family
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.listed import Listed, ListedObjects
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import find_object, names_of
from stylesplat.selection.identities import object_ids
from stylesplat.selection.own_shares import OwnShares
from stylesplat.selection.pick import each_object


def picks_of(scene: Scene) -> dict[str, Bool[Tensor, " N"]]:
    """Every object by its name, or by its label id if it has none."""
    picks = {name: each.picked for name, each in scene.objects.items()}
    if scene.splats.classifier is None:
        return picks
    unnamed = [id for id in object_ids(scene.splats) if not names_of(scene, id)]
    found = each_object(scene.unpainted, unnamed) if unnamed else ()
    rows = family(scene)
    return picks | {str(id): picked[rows] for id, picked in found if picked.any()}


def no_objects(scene: Scene) -> StyleSplatError:
    """What to say if something is wanted of each object."""
    return StyleSplatError(
        f"{scene.path or 'The scene'} has no objects. Name one with `stylesplat select`."
    )


def listed_objects(scene: Scene, names: Sequence[str] = ()) -> ListedObjects:
    """Objects of a scene with their Gaussians, and how much of these is theirs.

    Args:
        scene: Where they are.
        names: Their names or label ids; none for all there are.

    Returns:
        Also the label id of each Gaussian, if the scene has any: of those in doubt the label of
        the object that they are picked for.

    Raises:
        StyleSplatError: If the scene has no objects, or not these.
    """
    picks = {name: find_object(scene, name).cpu() for name in names} or picks_of(scene)
    if not picks:
        raise no_objects(scene)
    own, objects = OwnShares(scene.splats, scene.cameras), dict[str, Listed]()
    for name, picked in track(picks.items(), "listing objects", unit="object"):
        shares = own.of(picked)[picked]
        ids = tuple(scene.objects[name].how.get("ids", ())) if name in scene.objects else ()
        objects[name] = Listed(picked.nonzero()[:, 0], shares, ids or _own_id(name))
    return ListedObjects(len(scene.splats), objects, _labels(scene))


def _own_id(name: str) -> tuple[int, ...]:
    return (int(name),) if name.isdecimal() else ()


def _labels(scene: Scene) -> Int[Tensor, " N"] | None:
    if scene.splats.classifier is None:
        return None
    labels = torch.full((len(scene.splats),), BACKGROUND)
    rows = family(scene)
    for id, picked in each_object(scene.unpainted, object_ids(scene.splats)):
        labels[picked[rows]] = id
    return labels
