"""Several views at a time, each on its share of the cores.

The serial parts of drawing one view, and the waits of its parallel ones, leave cores idle that
another view can use.
"""

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from threading import Barrier
from typing import TypeVar

import torch
from numba import get_num_threads, set_num_threads

from stylesplat.interrupts import raise_if_interrupted
from stylesplat.progress import track
from stylesplat.rendering.kernels.jit import SHARED

T = TypeVar("T")
R = TypeVar("R")


class RenderPool:
    """Threads that live on, each with its share of the cores."""

    def __init__(self, most: int, device: torch.device | str = "cpu") -> None:
        """Start the threads: at most so many, one per core; one on a GPU."""
        cores = get_num_threads() if torch.device(device).type == "cpu" and SHARED else 1
        self.size = max(1, min(most, cores))
        self._pool: ThreadPoolExecutor | None = None
        if self.size > 1:
            torch_threads, ready = torch.get_num_threads(), Barrier(self.size)
            self._pool = ThreadPoolExecutor(self.size, "view", _share, (cores // self.size,))
            for begun in [self._pool.submit(ready.wait) for _ in range(self.size)]:
                begun.result()
            torch.set_num_threads(torch_threads)  # what one thread sets, later ones have too

    def in_order(self, function: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
        """The results of a function for each item; at most two per thread wait to be read."""
        if self._pool is None:
            yield from map(function, items)
            return
        enabled = torch.is_grad_enabled()  # which is each thread's own

        def work(item: T) -> R:
            with torch.set_grad_enabled(enabled):
                return function(item)

        waiting = deque[Future[R]]()
        for item in items:
            if len(waiting) == 2 * self.size:
                yield waiting.popleft().result()
            waiting.append(self._pool.submit(copy_context().run, work, item))
        while waiting:
            yield waiting.popleft().result()

    def end(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)


def map_views(
    function: Callable[[T], R], items: Sequence[T], device: torch.device | str = "cpu"
) -> Generator[R]:
    """The results of a function for each item, in order; several items at a time on the CPU.

    The function calls CPU kernels. At most two results per core wait to be read: they may be large.
    """
    if len(items) == 0:
        return
    yield function(items[0])  # loads the kernels, once
    pool = RenderPool(len(items) - 1, device)
    try:
        for result in pool.in_order(function, items[1:]):
            raise_if_interrupted()
            yield result
    finally:
        pool.end()


def per_view(
    function: Callable[[T], R], items: Sequence[T], what: str, device: torch.device | str = "cpu"
) -> Iterator[R]:
    """The results of a function for each view, in order, with their progress."""
    return track(map_views(function, items, device), what, total=len(items))


def _share(threads: int) -> None:
    set_num_threads(threads)
    torch.set_num_threads(threads)
