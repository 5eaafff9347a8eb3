"""The states of a studio, and its history, which undo and redo step through."""

import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.scene.compose import family
from stylesplat.scene.content import Extent, extent_of
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import find_object, names_of
from stylesplat.selection.identities import object_ids


@dataclass(frozen=True)
class StudioState:
    """Everything that undo takes back."""

    scene: Scene
    picked: tuple[str, ...] = ()
    """The names or label ids of the objects that are picked, in order."""
    hidden: frozenset[str] = frozenset()
    alone: bool = False
    """Only what is picked is displayed."""
    locked: frozenset[str] = frozenset()
    """Objects whose paint must not change."""
    commands: tuple[tuple[str, ...], ...] = ()
    """The commands that make these objects; `SCENE` stands for the scene's folder."""
    note: str = "Opened"
    """The last change, in a few words."""


class ObjectMasks:
    """The Gaussians of each object. To find those of a label id takes long, so it caches them."""

    def __init__(self) -> None:
        self._kept = dict[str, tuple[Tensor, Tensor]]()
        self._extents = dict[tuple[str, ...], tuple[Tensor, Extent]]()

    def of(self, scene: Scene, name: str) -> Bool[Tensor, " N"]:
        if name in scene.objects:
            return scene.objects[name].picked
        if name in scene.painted_objects:
            return find_object(scene, name)
        known, means = self._kept.get(name), scene.unpainted.means
        if known is None or known[0] is not means:
            found = find_object(scene, name)[: len(means)]
            known = self._kept[name] = (means, found)
        return known[1][family(scene)] if scene.layers else known[1]

    def extent(self, scene: Scene, names: tuple[str, ...]) -> Extent:
        """The box around some objects, at least one."""
        picked = self.together(scene, names)
        assert picked is not None
        own = picked[: len(scene.unpainted)]
        known = self._extents.get(names)
        if known is None or not torch.equal(known[0], own):
            known = self._extents[names] = own, extent_of(scene.unpainted, own)
        return known[1]

    def together(self, scene: Scene, names: Iterable[str]) -> Bool[Tensor, " N"] | None:
        """The Gaussians of several objects; None without objects."""
        masks = [self.of(scene, name) for name in names]
        return torch.stack(masks).any(dim=0) if masks else None


def object_names(scene: Scene) -> list[str]:
    """The objects of a scene: label ids without a name, then names."""
    ids = object_ids(scene.splats) if scene.splats.classifier is not None else ()
    return [*(str(id) for id in ids if not names_of(scene, id)), *scene.objects]


def hidden_rows(state: StudioState, masks: ObjectMasks) -> Bool[Tensor, " N"] | None:
    """The Gaussians that are not displayed; None if all are."""
    scene, hidden = state.scene, masks.together(state.scene, state.hidden)
    if state.alone and state.picked:
        picked = masks.together(scene, state.picked)
        hidden = None if picked is None else ~picked
    return none_if_all(hidden)


def none_if_all(hidden: Bool[Tensor, " N"] | None) -> Bool[Tensor, " N"] | None:
    return None if hidden is None or hidden.all() else hidden


def replace_scene(state: StudioState, scene: Scene, note: str) -> StudioState:
    """A state with another scene, and with those picked and hidden objects that it still has."""
    known = {*object_names(scene), *scene.painted_objects}
    return replace(
        state,
        scene=scene,
        picked=tuple(name for name in state.picked if name in known),
        hidden=state.hidden & known,
        locked=state.locked & {layer.name for layer in scene.layers},
        note=note,
    )


BUDGET = 2**28  # bytes in memory: a painting on 100,000 Gaussians takes 70 MB


class History:
    """States in their order, of which those that were not displayed for long lie on disk."""

    def __init__(self, first: StudioState, *, budget: int = BUDGET) -> None:
        self._states = dict[int, StudioState | Path]()  # by number; the last one used comes last
        self._next, self._budget = 0, budget
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._notes = dict[int, str]()
        self._rows, self._row = [self._put(first)], 0
        self._bookmarks = set[int]()
        self._merge: object = None
        self.now = first

    @property
    def on_disk(self) -> int:
        """Number of states on disk."""
        return sum(isinstance(state, Path) for state in self._states.values())

    @property
    def undo_note(self) -> str:
        """The change that undo takes back; empty if there is none."""
        return self.now.note if self._row else ""

    @property
    def redo_note(self) -> str:
        """The change that redo makes again; empty if there is none."""
        rows = self._rows[self._row + 1 : self._row + 2]
        return self._notes[rows[0]] if rows else ""

    def add(self, state: StudioState, *, merge: object = None) -> None:
        """Add a state and display it. It replaces the last one if both have the same `merge`."""
        kept = self._row + 1 - (merge is not None and merge == self._merge)
        for number in self._rows[kept:]:
            if number not in self._bookmarks:
                self._forget(number)
        self._rows[kept:] = [self._put(state)]
        self._row, self._merge, self.now = kept, merge, state

    def step(self, rows: int) -> None:
        """Go back or forth, as far as there are states."""
        self._row = min(max(self._row + rows, 0), len(self._rows) - 1)
        self._merge, self.now = None, self.at(self._rows[self._row])

    def bookmark(self) -> int:
        """Keep the displayed state for good; returns its number."""
        number = self._rows[self._row]
        self._bookmarks.add(number)
        self._merge = None
        return number

    def at(self, number: int) -> StudioState:
        """The state with a bookmark."""
        state = self._states.pop(number)
        if isinstance(state, Path):
            path, state = state, torch.load(state, weights_only=False)  # our own file
            path.unlink()
        assert isinstance(state, StudioState)
        self._states[number] = state
        self._spill()
        return state

    def close(self) -> None:
        """Remove the states on disk."""
        if self._folder is not None:
            self._folder.cleanup()

    def _put(self, state: StudioState) -> int:
        number, self._next = self._next, self._next + 1
        self._states[number], self._notes[number] = state, state.note
        self._spill()
        return number

    def _forget(self, number: int) -> None:
        state = self._states.pop(number)
        if isinstance(state, Path):
            state.unlink()

    def _spill(self) -> None:
        """Write states to disk until the others fit into the budget."""
        for number in [*self._states][:-1]:
            state = self._states[number]
            if isinstance(state, Path):
                continue
            if self._size() <= self._budget:
                return
            if self._folder is None:
                self._folder = tempfile.TemporaryDirectory(prefix="stylesplat-studio-")
            path = Path(self._folder.name) / f"{number}.pt"
            torch.save(state, path)
            self._states[number] = path

    def _size(self) -> int:
        """Bytes of the tensors in memory, each counted once, without those of the last state."""
        sizes = dict[int, int]()
        in_memory = [state for state in self._states.values() if isinstance(state, StudioState)]
        for state in in_memory:
            sizes |= {tensor.data_ptr(): tensor.nbytes for tensor in _tensors_in(state)}
        for tensor in _tensors_in(in_memory[-1]):
            sizes.pop(tensor.data_ptr(), None)
        return sum(sizes.values())


def _tensors_in(value: Any) -> Iterator[torch.Tensor]:
    if isinstance(value, torch.Tensor):
        yield value
    elif isinstance(value, dict):
        for each in value.values():
            yield from _tensors_in(each)
    elif isinstance(value, tuple):
        for each in value:
            yield from _tensors_in(each)
    elif is_dataclass(value):
        for field in fields(value):
            yield from _tensors_in(getattr(value, field.name))
