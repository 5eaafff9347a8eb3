"""Several views at a time."""

from threading import Barrier

import pytest
import torch
from numba import get_num_threads

from scenes import random_splats, two_cameras
from stylesplat.progress import say
from stylesplat.rendering.kernels.jit import SHARED
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.view_pool import map_views


def render(seed: int) -> torch.Tensor:
    return rasterize(random_splats(seed=seed), two_cameras())[0]


@pytest.fixture(autouse=True)
def loaded_kernels() -> None:
    render(0)


def test_order():
    pictures = [*map_views(render, range(7))]
    assert len(pictures) == 7
    assert all(torch.equal(a, render(b)) for a, b in zip(pictures, range(7), strict=True))


def test_at_a_time():
    if get_num_threads() < 2 or not SHARED:
        pytest.skip("one view at a time: there is one core, or numba has no OpenMP")
    both = Barrier(2, timeout=60)

    def meet(item: int) -> int:
        if item > 0:
            both.wait()
        return item

    assert [*map_views(meet, range(3))] == [0, 1, 2]


def test_gradients_as_outside():
    def enabled(item: int) -> bool:
        return torch.is_grad_enabled()

    with torch.no_grad():
        assert not any(map_views(enabled, range(5)))
    with torch.enable_grad():
        assert all(map_views(enabled, range(5)))


def test_listeners_hear_what_threads_say(said: list[str]):
    assert [*map_views(lambda item: say(f"{item}"), range(5))] == [None] * 5
    assert sorted(said) == [*"01234"] and [*map_views(say, [])] == []


def test_failure():
    def fail(item: int) -> int:
        if item == 3:
            raise ValueError("three")
        return item

    found = map_views(fail, range(9))
    assert [next(found) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="three"):
        next(found)
