import torch

from stylesplat.scene.lazy import Lazy


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


def test_nothing_is_kept():
    items, calls = counted(4)
    for _ in range(2):
        values = [item if item is None else int(item[0]) for item in items]
        assert values == [0, 1, None, 3]
    assert calls == [0, 1, 2, 3] * 2
    assert items[0] is not items[0]


def test_a_slice_is_lazy_too():
    items, calls = counted(4)
    part = items[2:]
    assert len(part) == 2 and calls == []
    assert part[0] is None and part[1][0] == 3
