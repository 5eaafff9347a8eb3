"""A store of bounded size."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

from torch import Tensor

Key = TypeVar("Key", bound=Hashable)
T = TypeVar("T", bound=tuple[Tensor | None, ...])

GIB = 2**30


class Cache(Generic[Key]):
    """Tuples of tensors by key, as many as fit; what was used longest ago is forgotten first."""

    def __init__(self, budget: int) -> None:
        """Start empty.

        Args:
            budget: Bytes that all items together may take; what is larger alone is not kept.
        """
        self._items: OrderedDict[Key, tuple[Tensor | None, ...]] = OrderedDict()
        self._budget = budget
        self._used = 0

    @property
    def used(self) -> int:
        """Bytes of what is kept."""
        return self._used

    def get(self, key: Key, make: Callable[[], T]) -> T:
        """What is kept under a key, or what `make` gives, which is then kept."""
        if key in self._items:
            self._items.move_to_end(key)
            return self._items[key]  # pyright: ignore[reportReturnType]
        item = make()
        if size_of(item) <= self._budget:
            self._items[key] = item
            self._used += size_of(item)
        while self._used > self._budget:
            self._drop(next(iter(self._items)))
        return item

    def forget(self, unwanted: Callable[[Key], bool]) -> None:
        """Drop the items whose keys are unwanted."""
        for key in [key for key in self._items if unwanted(key)]:
            self._drop(key)

    def _drop(self, key: Key) -> None:
        self._used -= size_of(self._items.pop(key))


def size_of(item: tuple[Tensor | None, ...]) -> int:
    """Bytes of some tensors together."""
    return sum(t.nbytes for t in item if t is not None)
