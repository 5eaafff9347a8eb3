"""States in bounded memory: those that were not looked at for long wait on disk."""

import tempfile
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import torch

from stylesplat.studio_app.studio_state import State

BUDGET = 2**28  # bytes in memory: a painting on 100,000 Gaussians takes 70 MB


class StoredStates:
    """States by number."""

    def __init__(self, budget: int = BUDGET) -> None:
        """Begin with none.

        Args:
            budget: Bytes that all but the last one looked at may take in memory.
        """
        self._kept = dict[int, State | Path]()  # what was looked at last comes last
        self._next, self._budget = 0, budget
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def put(self, state: State) -> int:
        """Keep one more; its number."""
        number, self._next = self._next, self._next + 1
        self._kept[number] = state
        self._spill()
        return number

    def get(self, number: int) -> State:
        """One that was kept."""
        state = self._kept.pop(number)
        if isinstance(state, Path):
            path, state = state, torch.load(state, weights_only=False)  # our own file
            path.unlink()
        assert isinstance(state, State)  # whatever was written
        self._kept[number] = state
        self._spill()
        return state

    def forget(self, number: int) -> None:
        """Keep it no longer."""
        state = self._kept.pop(number)
        if isinstance(state, Path):
            state.unlink()

    @property
    def on_disk(self) -> int:
        """How many wait there."""
        return sum(isinstance(state, Path) for state in self._kept.values())

    def close(self) -> None:
        """Remove what waits on disk."""
        if self._folder is not None:
            self._folder.cleanup()

    def _spill(self) -> None:
        for number in [*self._kept][:-1]:
            state = self._kept[number]
            if isinstance(state, Path):
                continue
            if self._size() <= self._budget:
                return
            self._kept[number] = self._written(number, state)

    def _size(self) -> int:
        """Bytes of what the states in memory hold, each tensor once, but for the last one's."""
        sizes = dict[int, int]()
        in_memory = [state for state in self._kept.values() if isinstance(state, State)]
        for state in in_memory:
            sizes |= {tensor.data_ptr(): tensor.nbytes for tensor in tensors_in(state)}
        for tensor in tensors_in(in_memory[-1]):
            sizes.pop(tensor.data_ptr(), None)
        return sum(sizes.values())

    def _written(self, number: int, state: State) -> Path:
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="stylesplat-studio-")
        path = Path(self._folder.name) / f"{number}.pt"
        torch.save(state, path)
        return path


def tensors_in(value: Any) -> Iterator[torch.Tensor]:
    """All that a state holds."""
    if isinstance(value, torch.Tensor):
        yield value
    elif isinstance(value, dict):
        for each in value.values():
            yield from tensors_in(each)
    elif isinstance(value, tuple):
        for each in value:
            yield from tensors_in(each)
    elif is_dataclass(value):
        for field in fields(value):
            yield from tensors_in(getattr(value, field.name))
