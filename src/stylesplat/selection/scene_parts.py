"""Parts of a scene for other programs, in the scene's world frame."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.compose import object_subset, spans
from stylesplat.scene.layer import Layer, layer_subset
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import find_object
from stylesplat.selection.objects import no_objects, picks_of

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
