"""Undo and redo without an end."""

from stylesplat.studio_app.stored_states import BUDGET, StoredStates
from stylesplat.studio_app.studio_state import State


class History:
    """States in the order in which they came about, and which of them is shown."""

    def __init__(self, first: State, *, budget: int = BUDGET) -> None:
        """Begin with a state.

        Args:
            first: What is shown now.
            budget: Bytes that all others may take in memory.
        """
        self._states = StoredStates(budget)
        self._rows, self._row = [self._states.put(first)], 0
        self._bookmarks = set[int]()
        self._merge: object = None
        self.now = first
        """The state that is shown."""

    @property
    def can_undo(self) -> bool:
        """Whether there is one before."""
        return self._row > 0

    @property
    def can_redo(self) -> bool:
        """Whether there is one after."""
        return self._row < len(self._rows) - 1

    @property
    def on_disk(self) -> int:
        """How many states wait there."""
        return self._states.on_disk

    def add(self, state: State, *, merge: object = None) -> None:
        """Show another state. What was undone before is forgotten.

        Args:
            state: The new one.
            merge: What is equal in both takes the place of the last one: a slider that moves.
        """
        kept = self._row + 1 - (merge is not None and merge == self._merge)
        for number in self._rows[kept:]:
            if number not in self._bookmarks:
                self._states.forget(number)
        self._rows[kept:] = [self._states.put(state)]
        self._row, self._merge, self.now = kept, merge, state

    def step(self, rows: int) -> None:
        """Go back, or forth; as far as there are states."""
        self._row = min(max(self._row + rows, 0), len(self._rows) - 1)
        self._merge, self.now = None, self._states.get(self._rows[self._row])

    def bookmark(self) -> int:
        """Keep the state that is shown, whatever is forgotten; its number."""
        number = self._rows[self._row]
        self._bookmarks.add(number)
        self._merge = None  # it is not replaced either
        return number

    def at(self, number: int) -> State:
        """A state with a bookmark."""
        return self._states.get(number)

    def close(self) -> None:
        """Remove what waits on disk."""
        self._states.close()
