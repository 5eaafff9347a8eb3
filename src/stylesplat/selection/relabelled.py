"""A scene with the labels of its views' label maps, lifted onto its Gaussians."""

from dataclasses import replace

import torch

from stylesplat.progress import say
from stylesplat.scene.capture import Capture
from stylesplat.scene.compose import family
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.scene import Scene
from stylesplat.selection.naming import with_names
from stylesplat.training.lifting import lift, with_labels_of


def relabelled(scene: Scene, masked: Capture, *, add: bool, device: torch.device) -> Scene:
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
