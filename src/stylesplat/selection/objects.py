"""The objects of a scene: their names, their Gaussians as lists, and labels lifted anew."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief
from stylesplat.progress import say, track
from stylesplat.scene.capture import Capture
from stylesplat.scene.compose import family
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.scene import ListedObject, ListedObjects, Scene, SceneObject, name_fault
from stylesplat.selection.choose import find_object, names_of
from stylesplat.selection.identities import object_ids
from stylesplat.selection.pick import THRESHOLD, each_object, pick_objects
from stylesplat.selection.soft_picks import OwnShares
from stylesplat.training.lifting import lift, with_labels_of


def with_names(scene: Scene, names: Mapping[int, str]) -> Scene:
    """Give objects the names that their label maps have.

    Args:
        scene: With identities if anything is to be named.
        names: By label id. A name is skipped if it is no valid name, another object has it, or the
            object has no Gaussians.
    """
    ids = object_ids(scene.splats) if scene.splats.classifier else ()
    known = {id: name for id, name in names.items() if id in ids}
    picked = pick_objects(scene.splats, [*known]) if known else {}
    for id, mask in picked.items():
        name = known[id]
        fault = _fault(scene, name, mask)
        if fault:
            say(
                f"Object {id} does not get the name {brief(name)!r}: {fault}. Name it with "
                "`stylesplat select`."
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
        return "no Gaussians belong to it"
    return "another object has it" if name in scene.objects else name_fault(name)


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
    """The error for a scene without objects."""
    return StyleSplatError(
        f"{scene.path or 'The scene'} has no objects. Name one with `stylesplat select`."
    )


def listed_objects(scene: Scene, names: Sequence[str] = ()) -> ListedObjects:
    """Objects of a scene with their Gaussians and soft shares.

    Args:
        scene: Where they are.
        names: Their names or label ids; none for all there are.

    Returns:
        The objects, and the label id of each Gaussian if the scene has any; a Gaussian in doubt has
        the label of the object that it is picked for.

    Raises:
        StyleSplatError: If the scene has no objects, or not these.
    """
    picks = {name: find_object(scene, name).cpu() for name in names} or picks_of(scene)
    if not picks:
        raise no_objects(scene)
    own, objects = OwnShares(scene.splats, scene.cameras), dict[str, ListedObject]()
    for name, picked in track(picks.items(), "listing objects", unit="object"):
        shares = own.of(picked)[picked]
        ids = tuple(scene.objects[name].how.get("ids", ())) if name in scene.objects else ()
        objects[name] = ListedObject(picked.nonzero()[:, 0], shares, ids or _own_id(name))
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


def relabel(scene: Scene, masked: Capture, *, add: bool, device: torch.device) -> Scene:
    """A scene whose Gaussians have the labels that label maps of its views give them.

    Args:
        scene: Without them.
        masked: Its views with label maps, and what their objects are called.
        add: Whether labels that it has stay, but for those of objects of the same names. Else
            objects that were chosen by label are forgotten.
        device: Where to compute.

    Raises:
        StyleSplatError: If no Gaussian shows in the label maps.
    """
    base = scene.unpainted
    lifted = lift(base.to(device), masked).to("cpu")
    names = dict(masked.object_names)
    if add and scene.splats.classifier is not None:
        renamed = _renamed(scene, lifted.classifier.ids if lifted.classifier else (), names)
        lifted = with_labels_of(base, lifted, renamed)
        names = {renamed[id]: name for id, name in names.items() if id in renamed}
    stay = {
        name: each
        for name, each in scene.objects.items()
        if name not in names.values() and (add or not each.how.get("ids"))
    }
    rows = family(scene)
    splats = replace(
        scene.splats,
        identities=None if lifted.identities is None else lifted.identities[rows],
        classifier=lifted.classifier,
        confidence=None if lifted.confidence is None else lifted.confidence[rows],
    )
    found = replace(scene, splats=splats, base=lifted if scene.layers else None, objects=stay)
    found = with_names(found, names)
    for name in names.values():
        if name in scene.objects and name in found.objects:
            before = int(scene.objects[name].picked.sum())
            say(f"{name!r} meant {before:,} Gaussians before.")
    return found


def _renamed(scene: Scene, ids: tuple[int, ...], names: dict[int, str]) -> dict[int, int]:
    """The ids that new labels get beside those that there are.

    An object of the same name gives up its own, if it is that of one label.
    """
    assert scene.splats.classifier is not None
    known = scene.splats.classifier.ids
    renamed, free = dict[int, int](), max(known) + 1
    for id in ids:
        if id == BACKGROUND:
            continue
        before = scene.objects.get(names.get(id, ""))
        own = before.how.get("ids", []) if before else []
        if len(own) == 1 and own[0] in known:
            renamed[id] = own[0]
        else:
            renamed[id], free = free, free + 1
    return renamed
