from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from threading import Barrier, BrokenBarrierError
from typing import NamedTuple

import pytest
import torch

from stylesplat.scene.cache import Cache, Lazy


def item(size: int, value: int = 0) -> tuple[torch.Tensor]:
    return (torch.full((size,), value, dtype=torch.uint8),)


class Shop:
    """A cache of items of ten bytes, and what had to be made for it."""

    def __init__(self, budget: int) -> None:
        self.cache: Cache[int] = Cache(budget)
        self.made: list[int] = []

    def get(self, key: int, size: int = 10) -> torch.Tensor:
        def make() -> tuple[torch.Tensor]:
            self.made.append(key)
            return item(size, key)

        return self.cache.get(key, make)[0]


def test_what_fits_is_made_once():
    shop = Shop(30)
    for key in (1, 2, 3, 1, 2, 3):
        assert int(shop.get(key)[0]) == key
    assert shop.made == [1, 2, 3] and shop.cache.used == 30


def test_what_was_used_longest_ago_goes_first():
    shop = Shop(30)
    for key in (1, 2, 3, 1, 4):  # 2 makes room for 4
        shop.get(key)
    for key in (1, 3, 4):
        shop.get(key)
    assert shop.made == [1, 2, 3, 4]
    shop.get(2)
    assert shop.made[-1] == 2


def test_the_budget_is_never_exceeded():
    shop, generator = Shop(55), torch.Generator().manual_seed(0)
    for key in torch.randint(20, (200,), generator=generator).tolist():
        shop.get(key, size=key + 1)
        assert shop.cache.used <= 55
    assert len(shop.made) > 20


def test_what_is_too_large_alone_is_not_kept_and_displaces_nothing():
    shop = Shop(30)
    shop.get(1)
    assert shop.get(2, size=31).numel() == 31
    shop.get(1)
    shop.get(2, size=31)
    assert shop.made == [1, 2, 2]


def test_forgetting_frees_room():
    shop = Shop(30)
    for key in (1, 2, 3):
        shop.get(key)
    shop.cache.forget(lambda key: key != 2)
    assert shop.cache.used == 10
    for key in (2, 4, 5):
        shop.get(key)
    assert shop.made == [1, 2, 3, 4, 5]


def test_threads_that_ask_for_the_same_item_share_it():
    cache: Cache[int] = Cache(100)
    both = Barrier(2)

    def make() -> tuple[torch.Tensor]:
        with suppress(BrokenBarrierError):  # one thread alone may make it
            both.wait(timeout=1)
        return item(10)

    with ThreadPoolExecutor(2) as pool:
        one, other = pool.map(lambda _: cache.get(0, make)[0], range(2))
    assert one is other and cache.used == 10


class Pair(NamedTuple):
    one: torch.Tensor
    other: torch.Tensor | None


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int16, torch.float32])
def test_what_is_kept_is_what_was_made(dtype: torch.dtype):
    cache: Cache[int] = Cache(1000)
    made = Pair(torch.arange(12).to(dtype).view(3, 4), None)
    for _ in range(2):
        kept = cache.get(0, lambda: made)
        assert isinstance(kept, Pair) and kept.other is None
        assert kept.one.dtype == dtype and torch.equal(kept.one, made.one)


def test_what_is_kept_is_a_copy():
    cache: Cache[int] = Cache(1000)
    made = item(10)
    kept = cache.get(0, lambda: made)[0]
    made[0][:] = 9
    assert not kept.any()


MEMORY = """
import mmap
from pathlib import Path
import torch
from stylesplat.scene.cache import Cache

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE

cache = Cache(2**28)
before = resident()
for key in range(200):
    cache.get(key, lambda: (torch.ones(2**20, dtype=torch.uint8),))
full = resident()
cache.forget(lambda key: key % 2 == 0)
print(full - before, full - resident())
"""


def counted(size: int) -> tuple[Lazy, list[int]]:
    calls: list[int] = []

    def maker(i: int):
        def make():
            calls.append(i)
            return torch.full((10,), i, dtype=torch.uint8) if i != 2 else None

        return make

    return Lazy([maker(i) for i in range(size)]), calls


def test_nothing_is_made_before_it_is_asked_for():
    items, calls = counted(4)
    assert len(items) == 4 and calls == []
    assert items[-1][0] == 3 and calls == [3]


def test_a_slice_is_lazy_too():
    items, calls = counted(4)
    part = items[2:]
    assert len(part) == 2 and calls == []
    assert part[0] is None and part[1][0] == 3
