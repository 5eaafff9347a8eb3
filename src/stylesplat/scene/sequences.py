"""Samples of sequences, sequences whose items are made on access, and a bounded store for them."""

import mmap
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from functools import wraps
from threading import RLock
from typing import Generic, TypeVar, overload
from weakref import WeakKeyDictionary, ref

import torch
from torch import Tensor

from stylesplat.runtime import tidy_heap
from stylesplat.scene.cameras import Cameras

T = TypeVar("T")


def evenly_spaced(items: Sequence[T], count: int) -> list[T]:
    """At most `count` of the items, at equal distances."""
    count = min(count, len(items))
    return [items[(2 * i + 1) * len(items) // (2 * count)] for i in range(count)]


def shuffled_repeats(items: Sequence[T], count: int, generator: torch.Generator) -> Iterator[T]:
    """Draws `count` items in random order, each equally often."""
    order: list[int] = []
    for _ in range(count):
        order = order or torch.randperm(len(items), generator=generator).tolist()
        yield items[order.pop()]


def farthest_views(cameras: Cameras, count: int) -> list[int]:
    """Rows of cameras chosen by farthest point sampling, the first farthest from the mean."""
    positions = cameras.positions.cpu()
    gaps = (positions - positions.mean(dim=0)).norm(dim=1)
    rows: list[int] = []
    while len(rows) < min(count, len(cameras)):
        row = int(gaps.argmax())
        distances = (positions - positions[row]).norm(dim=1)
        gaps = distances if not rows else torch.minimum(gaps, distances)
        rows.append(row)
        gaps[rows] = -1.0  # also where several cameras share a position
    return rows


Key = TypeVar("Key", bound=Hashable)
Item = TypeVar("Item", bound=tuple[Tensor | None, ...])

GIB = 2**30
TIDY_EVERY = 2**26  # bytes kept; the steps' own buffers then have to be mapped anew: a tenth second


class Cache(Generic[Key]):
    """A least-recently-used cache of tuples of tensors, copied to the CPU; threads may share it."""

    def __init__(self, budget: int) -> None:
        """Start empty; `budget` is the size in bytes that all items together may take."""
        self._items: OrderedDict[Key, tuple[Tensor | None, ...]] = OrderedDict()
        self._budget = budget
        self._used = 0
        self._since_tidied = 0
        self._lock = RLock()

    @property
    def used(self) -> int:
        return self._used

    def get(self, key: Key, make: Callable[[], Item]) -> Item:
        """Returns the item of a key, or makes and keeps it; items over the budget are not kept."""
        with self._lock:
            if key in self._items:
                self._items.move_to_end(key)
                return self._items[key]  # pyright: ignore[reportReturnType]
        item = make()  # without the lock, so that threads decode several at a time
        size = _size_of(item)
        if size > self._budget:
            return item
        copies = [t if t is None or t.nbytes == 0 else _copy(t) for t in item]
        item = getattr(type(item), "_make", type(item))(copies)  # also of a NamedTuple
        with self._lock:
            if key in self._items:  # another thread was faster
                return self._items[key]  # pyright: ignore[reportReturnType]
            self._items[key] = item
            self._used += size
            self._since_tidied += size
            while self._used > self._budget:
                self._drop(next(iter(self._items)))
            if self._since_tidied > TIDY_EVERY:
                self._since_tidied = 0
                tidy_heap()  # heads of kept tensors lie in what decoding freed: 6 MB a photo
        return item

    def forget(self, unwanted: Callable[[Key], bool]) -> None:
        with self._lock:
            for key in filter(unwanted, [*self._items]):
                self._drop(key)

    def _drop(self, key: Key) -> None:
        self._used -= _size_of(self._items.pop(key))


def _copy(tensor: Tensor) -> Tensor:
    """A copy in memory pages of its own, which return to the system when it is freed."""
    pages = mmap.mmap(-1, tensor.nbytes)
    return torch.frombuffer(pages, dtype=tensor.dtype).view(tensor.shape).copy_(tensor)


def _size_of(item: tuple[Tensor | None, ...]) -> int:
    return sum(t.nbytes for t in item if t is not None)


A = TypeVar("A")
B = TypeVar("B")
R = TypeVar("R")


def cached_while_alive(function: Callable[[A, B], R]) -> Callable[[A, B], R]:
    """Cache the last result for as long as its arguments live, which are told by identity.

    The cache keeps neither argument alive; the result must not either.
    """
    kept = WeakKeyDictionary[A, tuple[ref[B], R]]()

    @wraps(function)
    def cached(one: A, other: B) -> R:
        known = kept.get(one)
        if known is None or known[0]() is not other:
            kept.clear()
            known = kept[one] = ref(other), function(one, other)
        return known[1]

    return cached


Entry = TypeVar("Entry", bound=Tensor | None)


class Lazy(Sequence[Entry]):
    """Tensors that are made anew at each access."""

    def __init__(self, makers: Sequence[Callable[[], Entry]]) -> None:
        self._makers = makers

    def __len__(self) -> int:
        return len(self._makers)

    @overload
    def __getitem__(self, index: int) -> Entry: ...
    @overload
    def __getitem__(self, index: slice) -> "Lazy[Entry]": ...
    def __getitem__(self, index: int | slice) -> "Entry | Lazy[Entry]":
        if isinstance(index, slice):
            return Lazy(self._makers[index])
        return self._makers[range(len(self))[index]]()
