"""What the studio shows: a scene, which of its objects are picked, and how that came about."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.figures.live_splats import ViewerSplats
from stylesplat.scene.compose import family
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import find_object, names_of
from stylesplat.selection.identities import object_ids


@dataclass(frozen=True)
class State:
    """Everything that undo takes back."""

    scene: Scene
    """As it is now."""
    picked: tuple[str, ...] = ()
    """The names or label ids of the objects that are picked, in order."""
    hidden: frozenset[str] = frozenset()
    """Those that are not shown."""
    alone: bool = False
    """Whether only what is picked is shown."""
    glow: bool = True
    """Whether what is picked glows."""
    commands: tuple[tuple[str, ...], ...] = ()
    """What would make these objects on the command line; `SCENE` stands for its folder."""
    note: str = "Opened"
    """What was done last, in a few words."""


class Masks:
    """Which Gaussians each object is; that of a label id takes a while, so it is kept."""

    def __init__(self) -> None:
        self._kept = dict[str, tuple[Tensor, Tensor]]()

    def of(self, scene: Scene, name: str) -> Bool[Tensor, " N"]:
        """The Gaussians of one object.

        Raises:
            StyleSplatError: If there is none of that name.
        """
        if name in scene.objects:
            return scene.objects[name].picked
        if name in scene.painted_objects:
            return find_object(scene, name)
        known, means = self._kept.get(name), scene.unpainted.means
        if known is None or known[0] is not means:
            found = find_object(scene, name)[: len(means)]
            known = self._kept[name] = (means, found)
        return known[1][family(scene)] if scene.layers else known[1]

    def together(self, scene: Scene, names: Iterable[str]) -> Bool[Tensor, " N"] | None:
        """All Gaussians of some objects; None if there are none of these."""
        masks = [self.of(scene, name) for name in names]
        return torch.stack(masks).any(dim=0) if masks else None


def names_in(scene: Scene) -> list[str]:
    """What objects a scene has: label ids that have no name, then names."""
    ids = object_ids(scene.splats) if scene.splats.classifier is not None else ()
    return [*(str(id) for id in ids if not names_of(scene, id)), *scene.objects]


def shown(state: State, masks: Masks) -> ViewerSplats:
    """What is seen of a state."""
    scene, picked = state.scene, masks.together(state.scene, state.picked)
    hidden = masks.together(scene, state.hidden)
    if state.alone and picked is not None:
        hidden = ~picked
    return ViewerSplats(scene.splats, picked if state.glow else None, unless_all(hidden))


def unless_all(hidden: Bool[Tensor, " N"] | None) -> Bool[Tensor, " N"] | None:
    """What is hidden; nothing where that would be everything."""
    return None if hidden is None or hidden.all() else hidden


def with_scene(state: State, scene: Scene, note: str) -> State:
    """Another scene, and of what is picked and hidden what it still has."""
    known = {*names_in(scene), *scene.painted_objects}
    return replace(
        state,
        scene=scene,
        picked=tuple(name for name in state.picked if name in known),
        hidden=state.hidden & known,
        note=note,
    )
