"""Sequences whose items are made when they are asked for."""

from collections.abc import Callable, Sequence
from typing import TypeVar, overload

from torch import Tensor

T = TypeVar("T", bound=Tensor | None)


class Lazy(Sequence[T]):
    """Tensors that are made anew at each access; who needs them often keeps them in a `Cache`."""

    def __init__(self, makers: Sequence[Callable[[], T]]) -> None:
        self._makers = makers

    def __len__(self) -> int:
        return len(self._makers)

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> "Lazy[T]": ...
    def __getitem__(self, index: int | slice) -> "T | Lazy[T]":
        if isinstance(index, slice):
            return Lazy(self._makers[index])
        return self._makers[range(len(self))[index]]()
