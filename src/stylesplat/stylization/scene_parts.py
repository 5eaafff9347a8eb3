"""Parts of a scene for other programs. They lie where they did, so that they fit together."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.paintings import Painted
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import find_object, names_of
from stylesplat.selection.identities import object_ids
from stylesplat.stylization.bookkeeping import taken_rows

REST = "rest"  # what the part is called that belongs to no object


def part_of(scene: Scene, objects: Sequence[str] = (), without: Sequence[str] = ()) -> Scene:
    """Some objects alone, or all but some: to be shown, as nothing can be taken back from it.

    Args:
        scene: Where they are.
        objects: Names or label ids of what to keep; none for everything.
        without: Names or label ids of what to leave out.

    Raises:
        StyleSplatError: If the scene has no such object, or nothing is left.
    """
    kept = torch.full((len(scene.splats),), not objects)
    for name in objects:
        kept |= find_object(scene, name).cpu()
    for name in without:
        kept &= ~find_object(scene, name).cpu()
    if not kept.any():
        raise StyleSplatError(
            f"Nothing is left of {scene.path or 'the scene'} without {', '.join(without)}. Leave "
            "out less."
        )
    return _cut_out(scene, kept)


def every_part(scene: Scene) -> dict[str, Scene]:
    """Each object alone, by its name, or by its label id if it has none; and the rest, if any.

    Objects that overlap are in each other's parts.

    Raises:
        StyleSplatError: If the scene has no objects, or one is called like the rest.
    """
    ids = object_ids(scene.splats) if scene.splats.classifier is not None else ()
    names = [*scene.objects, *(str(id) for id in ids if not names_of(scene, id))]
    if not names:
        raise StyleSplatError(
            f"{scene.path or 'The scene'} has no objects. Name one with `stylesplat select`."
        )
    if REST in names:
        raise StyleSplatError(
            f"An object is called {REST!r}, as what belongs to no object will be. Call it "
            "something else with `stylesplat rename`."
        )
    picks = {name: find_object(scene, name).cpu() for name in names}
    picks[REST] = ~torch.stack([*picks.values()]).any(dim=0)
    return {name: _cut_out(scene, picked) for name, picked in picks.items() if picked.any()}


def _cut_out(scene: Scene, kept: Bool[Tensor, " N"]) -> Scene:
    rows = kept.nonzero()[:, 0]
    objects = {
        name: taken_rows(each, rows)
        for name, each in scene.objects.items()
        if each.picked[rows].any()
    }
    painted = scene.painted and _painted_part(scene.painted, rows)
    return replace(scene, splats=scene.splats[rows], objects=objects, painted=painted, path=None)


def _painted_part(painted: Painted, rows: Tensor) -> Painted:
    return replace(
        painted,
        paintings=tuple(replace(each, picked=each.picked[rows]) for each in painted.paintings),
        before=painted.before[rows],
        full=painted.full[rows],
        unsplit=None,
    )
