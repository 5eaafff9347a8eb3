import torch

from stylesplat.scene.sequences import Cache


class Shop:
    """A cache of items of ten bytes, and what had to be made for it."""

    def __init__(self, budget: int) -> None:
        self.cache: Cache[int] = Cache(budget)
        self.made: list[int] = []

    def get(self, *keys: int, size: int = 10) -> None:
        def make() -> tuple[torch.Tensor]:
            self.made.append(key)
            return (torch.full((size,), key, dtype=torch.uint8),)

        for key in keys:
            (item,) = self.cache.get(key, make)
            assert item.tolist() == [key] * size
        assert self.cache.used <= 30


def test_what_fits_is_made_once_and_what_was_used_longest_ago_goes_first():
    shop = Shop(30)
    shop.get(1, 2, 3, 1, 2, 3, 1)
    assert shop.made == [1, 2, 3] and shop.cache.used == 30
    shop.get(4, 1, 3, 4)  # 2 makes room for 4
    assert shop.made == [1, 2, 3, 4]
    shop.get(2)
    assert shop.made[-1] == 2
    shop.get(9, size=25)
    assert shop.cache.used == 25
    shop.get(8, size=31)  # alone too large
    assert shop.cache.used == 25
    shop.cache.forget(lambda key: key == 9)
    assert shop.cache.used == 0
