"""The states of a studio, and its history, which undo and redo step through."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from weakref import ref

import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.content import Extent, extent_of
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import Selection
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import object_ids
from stylesplat.selection.resolve import find_object, names_of

MOST_STEPS = 200  # of a history: the oldest make room
MOST_SNAPSHOTS = 30


@dataclass(frozen=True, eq=False)
class Selected:
    """What is selected, until something else is."""

    weights: UInt8[Tensor, " B"]
    """How much each Gaussian belongs to it, in 255ths."""
    record: Selection
    """How it is recorded once it is an object."""
    origin: str = ""
    """The object that it began as."""

    @property
    def is_soft(self) -> bool:
        return bool(((self.weights > 0) & (self.weights < 255)).any())


@dataclass(frozen=True, eq=False)
class StudioState:
    scene: Scene
    picked: tuple[str, ...] = ()
    """The names or label ids of the objects that are picked, in order."""
    selection: Selected | None = None
    """What is selected; then no object is picked."""
    hidden: frozenset[str] = frozenset()
    locked: frozenset[str] = frozenset()
    """Layers that must not change."""
    solo: tuple[str, Mapping[str, bool]] | None = None
    """The layer that is shown alone, and which were visible before."""
    note: str = "Opened"
    """The last change, in a few words."""


class ObjectMasks:
    """The rows of each object. To find those of a label id takes long, so it caches them."""

    def __init__(self) -> None:
        self._kept = dict[str, tuple[Splats, Tensor]]()
        self._extents = dict[tuple[str, ...], tuple[Tensor, Extent]]()

    def has(self, scene: Scene, name: str) -> bool:
        """Whether they are found at once."""
        named = name in scene.objects or name in scene.painted_objects
        return named or (name in self._kept and self._kept[name][0] is scene.base)

    def of(self, scene: Scene, name: str) -> Bool[Tensor, " B"]:
        if name in scene.objects or name in scene.painted_objects:
            return find_object(scene, name)
        if not self.has(scene, name):
            self._kept[name] = scene.base, find_object(scene, name)
        return self._kept[name][1]

    def extent(self, scene: Scene, names: tuple[str, ...]) -> Extent:
        own = self.together(scene, names)
        assert own is not None
        return self.extent_of(scene, names, own)

    def extent_of(self, scene: Scene, names: tuple[str, ...], own: Bool[Tensor, " B"]) -> Extent:
        """The extent of some rows, of which the last of each name are cached."""
        known = self._extents.get(names)
        if known is None or not torch.equal(known[0], own):
            known = self._extents[names] = own, extent_of(scene.base, own)
        return known[1]

    def picked(self, state: StudioState) -> Bool[Tensor, " B"] | None:
        """The rows of what is selected or picked; None if nothing is."""
        if state.selection is not None:
            return state.selection.weights >= 128
        return self.together(state.scene, state.picked)

    def together(self, scene: Scene, names: Iterable[str]) -> Bool[Tensor, " B"] | None:
        """The rows of several objects; None without objects."""
        masks = [self.of(scene, name) for name in names]
        return torch.stack(masks).any(dim=0) if masks else None


def object_names(scene: Scene) -> list[str]:
    """The objects of a scene: label ids without a name, then names."""
    ids = object_ids(scene.base) if scene.base.classifier is not None else ()
    return [*(str(id) for id in ids if not names_of(scene, id)), *scene.objects]


def known_objects(scene: Scene) -> set[str]:
    """All that can be picked, painted and hidden by its name."""
    return {*object_names(scene), *scene.painted_objects}


def require_objects(scene: Scene, names: Iterable[str]) -> None:
    """Refuse names that are not there: a page may have them from before a change by another."""
    known = known_objects(scene)
    missing = next((name for name in names if name not in known), None)
    if missing is not None:
        raise StyleSplatError(f"There is no object {missing} any more. Choose another one.")


def hidden_rows(state: StudioState, masks: ObjectMasks) -> Bool[Tensor, " N"] | None:
    """The Gaussians that are not displayed; None if all are."""
    hidden = masks.together(state.scene, state.hidden)
    return None if hidden is None or hidden.all() else state.scene.to_splats(hidden)


def require_picked(state: StudioState) -> None:
    if not state.picked and state.selection is None:
        raise StyleSplatError("Nothing is picked. Click an object first.")


def replace_scene(state: StudioState, scene: Scene, note: str) -> StudioState:
    """A state with another scene, and with those picked and hidden objects that it still has."""
    known = known_objects(scene)
    return replace(
        state,
        scene=scene,
        picked=tuple(name for name in state.picked if name in known),
        hidden=state.hidden & known,
        locked=state.locked & {layer.name for layer in scene.layers},
        note=note,
    )


class CompactState:
    """A state, of whose scene only the base and the layers are kept while nobody else has it.

    The composed splats take most of the memory, and can be composed again.
    """

    def __init__(self, state: StudioState) -> None:
        self._scene = ref(state.scene)
        self.bare = replace(state, scene=replace(state.scene, composed=None))

    @property
    def scene(self) -> Scene | None:
        """The scene, if somebody else has it, too."""
        return self._scene()

    def state(self) -> StudioState:
        scene = self._scene() or replace(self.bare.scene)
        self._scene = ref(scene)
        return replace(self.bare, scene=scene)


@dataclass(eq=False)
class Step:
    """A state that can be gone back to: of the history, or a snapshot."""

    number: int
    """Its own for as long as it is there, unlike its place."""
    note: str
    kept: CompactState | None = None
    """None if it is on the disk alone."""
    picture: bytes = b""
    """A small JPEG of what a page showed then."""


class History:
    def __init__(self, first: StudioState) -> None:
        self.now = first
        self.steps, self.row = [Step(1, first.note, CompactState(first))], 0
        self.snapshots = list[Step]()
        self.read: Callable[[Step], StudioState] | None = None
        """Reads a state that is on the disk alone."""
        self._numbers = count(2)
        self._merge: object = None

    @property
    def step_now(self) -> Step:
        return self.steps[self.row]

    @property
    def undo_note(self) -> str:
        return self.now.note if self.row else ""

    @property
    def redo_note(self) -> str:
        later = self.steps[self.row + 1 :]
        return later[0].note if later else ""

    def add(self, state: StudioState, *, merge: object = None) -> None:
        """Add a state and display it. It replaces the last one if both have the same `merge`."""
        before, again = self.step_now, merge is not None and merge == self._merge
        alike = state.scene is self.now.scene and state.hidden == self.now.hidden
        number = before.number if again else next(self._numbers)
        step = Step(number, state.note, CompactState(state), before.picture if alike else b"")
        self.row += not again
        self.steps[self.row :] = [step]
        self._merge, self.now = merge, state
        self.drop_oldest(len(self.steps) - MOST_STEPS)

    def take_back(self, merge: object) -> None:
        """Drop the last state, if it was added with this `merge`."""
        if merge is not None and self._merge is merge:
            self.step(-1)
            del self.steps[self.row + 1 :]

    def step(self, rows: int) -> None:
        """Go back or forth, as far as there are states."""
        row = min(max(self.row + rows, 0), len(self.steps) - 1)
        self.now = self.state_of(self.steps[row])
        self._merge, self.row = None, row

    def row_of(self, number: int) -> int:
        return self.steps.index(find_step(self.steps, number))

    def state_of(self, step: Step) -> StudioState:
        if step.kept is not None:
            return step.kept.state()
        assert self.read is not None  # else all are kept
        return self.read(step)

    def keep_snapshot(self, name: str) -> None:
        """Keep the present state under a name, whatever becomes of the history."""
        if len(self.snapshots) >= MOST_SNAPSHOTS:
            raise StyleSplatError(f"{MOST_SNAPSHOTS} snapshots are kept. Delete one first.")
        compact, picture = CompactState(self.now), self.step_now.picture
        self.snapshots.append(Step(next(self._numbers), name, compact, picture))

    def drop_oldest(self, count: int) -> None:
        """Drop states of long ago, but not the present one."""
        count = min(max(count, 0), self.row)
        del self.steps[:count]
        self.row -= count

    def go_on_with(self, steps: Sequence[Step], row: int, snapshots: Sequence[Step]) -> None:
        """Take the place of this history by an earlier one."""
        now = self.state_of(steps[row])
        self.steps, self.row, self.now, self.snapshots = [*steps], row, now, [*snapshots]
        self._numbers = count(1 + max(each.number for each in (*steps, *snapshots)))


def find_step(steps: Sequence[Step], number: int) -> Step:
    """The step of a number, which a page may have from before a restart."""
    found = next((each for each in steps if each.number == number), None)
    if found is None:
        raise StyleSplatError("This step is not there any more. Choose another one.")
    return found
