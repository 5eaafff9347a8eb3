"""Objects of a scene: names, Gaussians as lists, labels lifted anew, parts for other programs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError, shorten
from stylesplat.progress import say, track
from stylesplat.scene.capture import BACKGROUND, Capture
from stylesplat.scene.layers import layer_subset
from stylesplat.scene.objects import ListedObject, ListedObjects, SceneObject, name_fault
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import Selection
from stylesplat.selection.labels import each_object, object_ids
from stylesplat.selection.resolve import find_object, names_of
from stylesplat.selection.shares import OwnShares
from stylesplat.training.lifting import lift, with_labels_of

REST_NAME = "rest"  # name of the part that belongs to no object


def part_mask(
    scene: Scene, objects: Sequence[str] = (), without: Sequence[str] = ()
) -> Bool[Tensor, " B"]:
    """The rows of some objects (by default of everything) without those of others."""
    kept = torch.full((len(scene.base),), not objects)
    for name in objects:
        kept |= find_object(scene, name).cpu()
    if not kept.any():
        raise StyleSplatError(
            f"Cannot export {', '.join(objects)}: it has no Gaussians. Select it again."
        )
    for name in without:
        kept &= ~find_object(scene, name).cpu()
    if not kept.any():
        raise StyleSplatError(
            f"Nothing is left of {scene.path or 'the scene'} without {', '.join(without)}. Leave "
            "out less."
        )
    return kept


def every_part(scene: Scene) -> dict[str, Scene]:
    """Each object alone, by its name, or by its label id if it has none; and the rest, if any."""
    masks = masks_of(scene)
    if not masks:
        raise no_objects_error(scene)
    if REST_NAME in masks:
        raise StyleSplatError(
            f"An object is called {REST_NAME!r}, as what belongs to no object will be. Call it "
            "something else with `stylesplat rename`."
        )
    masks[REST_NAME] = ~torch.stack([*masks.values()]).any(dim=0)
    return {name: cut_out(scene, mask) for name, mask in masks.items() if mask.any()}


def cut_out(scene: Scene, mask: Bool[Tensor, " B"]) -> Scene:
    """A scene of some rows of the base alone, with their parts of objects and layers."""
    parts = {name: replace(each, mask=each.mask[mask]) for name, each in scene.objects.items()}
    places = torch.where(mask, mask.cumsum(dim=0) - 1, -1)
    layers = [layer_subset(layer, places) for layer in scene.layers]
    return replace(
        scene,
        base=scene.base[mask],
        layers=tuple(layer for layer in layers if len(layer.rows)),
        objects={name: each for name, each in parts.items() if each.mask.any()},
        path=None,
    )


def with_names(scene: Scene, names: Mapping[int, str]) -> Scene:
    """Give objects names by label id; reports names that are invalid, taken, or of no Gaussians."""
    ids = object_ids(scene.base) if scene.base.classifier else ()
    known = {id: name for id, name in names.items() if id in ids}
    for id, mask in each_object(scene.base, [*known]) if known else ():
        name = known[id]
        fault = "another object has it" if name in scene.objects else name_fault(name)
        if fault or not mask.any():
            say(
                f"Object {id} does not get the name {shorten(name)!r}: "
                f"{fault or 'no Gaussians belong to it'}. Name it with `stylesplat select`."
            )
            continue
        scene = scene.with_object(name, SceneObject(mask, Selection(ids=(id,))))
    return scene


def require_named(scene: Scene, name: str) -> SceneObject:
    """The object of a name; refuses an unknown name."""
    if name in scene.objects:
        return scene.objects[name]
    known = ", ".join(scene.objects) or "none"
    raise StyleSplatError(
        f"No object of {scene.path or 'the scene'} is called {shorten(name)!r}. Names: {known}. "
        "Objects get names by `stylesplat select`."
    )


def masks_of(scene: Scene) -> dict[str, Bool[Tensor, " B"]]:
    """Every object by its name, or by its label id if it has none."""
    masks = {name: each.mask for name, each in scene.objects.items()}
    if scene.base.classifier is None:
        return masks
    unnamed = [id for id in object_ids(scene.base) if not names_of(scene, id)]
    found = each_object(scene.base, unnamed) if unnamed else ()
    return masks | {str(id): mask for id, mask in found if mask.any()}


def no_objects_error(scene: Scene) -> StyleSplatError:
    """The error for a scene without objects."""
    return StyleSplatError(
        f"{scene.path or 'The scene'} has no objects. Name one with `stylesplat select`."
    )


def listed_objects(scene: Scene, names: Sequence[str] = ()) -> ListedObjects:
    """Some or all objects of a scene with their Gaussians and soft shares, and all labels."""
    masks = {name: find_object(scene, name).cpu() for name in names} or masks_of(scene)
    if not masks:
        raise no_objects_error(scene)
    own, objects = OwnShares(scene.splats, scene.cameras), dict[str, ListedObject]()
    for name, mask in track(masks.items(), "listing objects", unit="object"):
        picked = scene.to_splats(mask)
        shares = own.of(picked)[picked]
        ids = scene.objects[name].selection.ids if name in scene.objects else ()
        own_id = (int(name),) if name.isdecimal() else ()
        objects[name] = ListedObject(picked.nonzero()[:, 0], shares, ids or own_id)
    labels = None
    if scene.base.classifier is not None:
        labels = torch.full((len(scene.base),), BACKGROUND)
        for id, mask in each_object(scene.base, object_ids(scene.base)):
            labels[mask] = id
        labels = scene.to_splats(labels)
    return ListedObjects(len(scene.splats), objects, labels)


def relabel(scene: Scene, masked: Capture, *, add: bool, device: torch.device) -> Scene:
    """The scene with labels and names lifted from label maps of its views.

    With `add`, other labels of the scene stay, and objects of the same names are replaced; else all
    objects that were selected by label are replaced.
    """
    lifted = lift(scene.base.to(device), masked).to("cpu")
    names = dict(masked.object_names)
    if add and scene.base.classifier is not None:
        renamed = _renamed(scene, lifted.classifier.ids if lifted.classifier else (), names)
        lifted = with_labels_of(scene.base, lifted, renamed)
        names = {renamed[id]: name for id, name in names.items() if id in renamed}
    stay = {
        name: each
        for name, each in scene.objects.items()
        if name not in names.values() and (add or not each.selection.ids)
    }
    found = with_names(replace(scene, base=lifted, objects=stay), names)
    for name in names.values():
        if name in scene.objects and name in found.objects:
            before = int(scene.objects[name].mask.sum())
            say(f"{name!r} meant {before:,} Gaussians before.")
    return found


def _renamed(scene: Scene, ids: tuple[int, ...], names: dict[int, str]) -> dict[int, int]:
    """Ids for new labels beside the known ones; an object of the same name gives its only id."""
    assert scene.base.classifier is not None
    known = scene.base.classifier.ids
    renamed, free = dict[int, int](), max(known) + 1
    for id in ids:
        if id == BACKGROUND:
            continue
        before = scene.objects.get(names.get(id, ""))
        own = before.selection.ids if before else ()
        if len(own) == 1 and own[0] in known:
            renamed[id] = own[0]
        else:
            renamed[id], free = free, free + 1
    return renamed
