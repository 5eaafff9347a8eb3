import torch

from stylesplat.scene.cache import Cache, size_of


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


def test_without_a_budget_nothing_is_kept():
    shop = Shop(0)
    shop.get(1)
    shop.get(1)
    assert shop.made == [1, 1] and shop.cache.used == 0


def test_forgetting_frees_room():
    shop = Shop(30)
    for key in (1, 2, 3):
        shop.get(key)
    shop.cache.forget(lambda key: key != 2)
    assert shop.cache.used == 10
    for key in (2, 4, 5):
        shop.get(key)
    assert shop.made == [1, 2, 3, 4, 5]


def test_items_may_be_made_of_other_items():
    cache: Cache[str] = Cache(100)

    def half() -> tuple[torch.Tensor]:
        return (cache.get("whole", lambda: item(10))[0][:5],)

    cache.get("half", half)
    assert cache.used == 15


def test_size_counts_tensors_and_ignores_none():
    assert size_of((torch.zeros(3), None, torch.zeros(2, dtype=torch.uint8))) == 14
    assert size_of((None,)) == 0
