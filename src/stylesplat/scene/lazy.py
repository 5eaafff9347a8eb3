"""Sequences whose items are made when they are asked for."""

from collections.abc import Callable, Sequence
from typing import TypeVar, overload

from torch import Tensor

T = TypeVar("T", bound=Tensor | None)

CACHE_BYTES = 2 << 30  # items are kept while they fit, so that small captures are read once


class Lazy(Sequence[T]):
    """Tensors that are made on access, and kept as long as all that are kept fit a budget."""

    def __init__(self, makers: Sequence[Callable[[], T]], budget: int = CACHE_BYTES) -> None:
        self._makers = makers
        self._room = budget
        self._kept: dict[int, T] = {}

    def __len__(self) -> int:
        return len(self._makers)

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> "Lazy[T]": ...
    def __getitem__(self, index: int | slice) -> "T | Lazy[T]":
        if isinstance(index, slice):
            return Lazy(self._makers[index], self._room)
        index = range(len(self))[index]
        if index in self._kept:
            return self._kept[index]
        item = self.unkept(index)
        size = item.nbytes if item is not None else 0
        if size <= self._room:
            self._kept[index] = item
            self._room -= size
        return item

    def unkept(self, index: int) -> T:
        """An item that is not kept if it is made for this."""
        index = range(len(self))[index]
        return self._kept[index] if index in self._kept else self._makers[index]()


def glance(items: Sequence[T], row: int) -> T:
    """One of some items; where they are made on access, it is not kept."""
    return items.unkept(row) if isinstance(items, Lazy) else items[row]
