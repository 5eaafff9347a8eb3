"""Objects of a scene: names, Gaussians as lists, labels lifted anew, parts for other programs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief
from stylesplat.progress import say, track
from stylesplat.scene.capture import BACKGROUND, Capture
from stylesplat.scene.compose import family, object_subset, spans
from stylesplat.scene.layer import Layer, layer_subset
from stylesplat.scene.scene import ListedObject, ListedObjects, Scene, SceneObject, name_fault
from stylesplat.selection.choose import find_object, names_of
from stylesplat.selection.labels import THRESHOLD, each_object, object_ids
from stylesplat.selection.shares import OwnShares
from stylesplat.training.lifting import lift, with_labels_of

REST = "rest"  # name of the part that belongs to no object


def rows_of_part(
    scene: Scene, objects: Sequence[str] = (), without: Sequence[str] = ()
) -> Int[Tensor, " M"]:
    """The Gaussians of some objects (by default of everything) without those of others."""
    kept = torch.full((len(scene.splats),), not objects)
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
    return kept.nonzero()[:, 0]


def every_part(scene: Scene) -> dict[str, Scene]:
    """Each object alone, by its name, or by its label id if it has none; and the rest, if any."""
    picks = picks_of(scene)
    if not picks:
        raise no_objects(scene)
    if REST in picks:
        raise StyleSplatError(
            f"An object is called {REST!r}, as what belongs to no object will be. Call it "
            "something else with `stylesplat rename`."
        )
    picks[REST] = ~torch.stack([*picks.values()]).any(dim=0)
    return {
        name: cut_out(scene, picked.nonzero()[:, 0])
        for name, picked in picks.items()
        if picked.any()
    }


def cut_out(scene: Scene, rows: Int[Tensor, " M"]) -> Scene:
    """A scene of some Gaussians alone, with their parts of objects and layers.

    `rows` are in ascending order.
    """
    objects = {
        name: object_subset(each, rows)
        for name, each in scene.objects.items()
        if each.picked[rows].any()
    }
    own = rows[rows < len(scene.unpainted)]
    layers = list[Layer]()
    places = torch.full((len(scene.unpainted),), -1)
    places[own] = torch.arange(len(own))
    for layer, first, end in spans(scene) if len(own) else ():
        canvas = rows[(rows >= first) & (rows < end)] - first
        part = layer_subset(layer, places, canvas)
        if len(part.rows) or len(canvas):
            layers.append(part)
    return replace(
        scene,
        splats=scene.splats[rows],
        base=scene.unpainted[own] if layers else None,
        layers=tuple(layers),
        objects=objects,
        path=None,
    )


def with_names(scene: Scene, names: Mapping[int, str]) -> Scene:
    """Give objects names by label id; reports names that are invalid, taken, or of no Gaussians."""
    ids = object_ids(scene.splats) if scene.splats.classifier else ()
    known = {id: name for id, name in names.items() if id in ids}
    for id, mask in each_object(scene.splats, [*known]) if known else ():
        name = known[id]
        fault = "another object has it" if name in scene.objects else name_fault(name)
        if fault or not mask.any():
            say(
                f"Object {id} does not get the name {brief(name)!r}: "
                f"{fault or 'no Gaussians belong to it'}. Name it with `stylesplat select`."
            )
            continue
        how = {"ids": [id], "threshold": THRESHOLD, "gaussians": int(mask.sum())}
        scene = scene.with_object(name, SceneObject(mask, how))
    return scene


def require_named(scene: Scene, name: str) -> SceneObject:
    """The object of a name; refuses an unknown name."""
    if name in scene.objects:
        return scene.objects[name]
    known = ", ".join(scene.objects) or "none"
    raise StyleSplatError(
        f"No object of {scene.path or 'the scene'} is called {brief(name)!r}. Names: {known}. "
        "Objects get names by `stylesplat select`."
    )


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
    """Some or all objects of a scene with their Gaussians and soft shares, and all labels."""
    picks = {name: find_object(scene, name).cpu() for name in names} or picks_of(scene)
    if not picks:
        raise no_objects(scene)
    own, objects = OwnShares(scene.splats, scene.cameras), dict[str, ListedObject]()
    for name, picked in track(picks.items(), "listing objects", unit="object"):
        shares = own.of(picked)[picked]
        ids = scene.objects[name].how.get("ids", ()) if name in scene.objects else ()
        own_id = (int(name),) if name.isdecimal() else ()
        objects[name] = ListedObject(picked.nonzero()[:, 0], shares, tuple(ids) or own_id)
    labels = None
    if scene.splats.classifier is not None:
        labels, rows = torch.full((len(scene.splats),), BACKGROUND), family(scene)
        for id, picked in each_object(scene.unpainted, object_ids(scene.splats)):
            labels[picked[rows]] = id
    return ListedObjects(len(scene.splats), objects, labels)


def relabel(scene: Scene, masked: Capture, *, add: bool, device: torch.device) -> Scene:
    """The scene with labels and names lifted from label maps of its views.

    With `add`, other labels of the scene stay, and objects of the same names are replaced; else all
    objects that were selected by label are replaced.
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
    """Ids for new labels beside the known ones; an object of the same name gives its only id."""
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
