"""Several views at a time, each on its share of the cores.

The serial parts of drawing one view, and the waits of its parallel ones, leave cores idle that
another view can use.
"""

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from itertools import islice
from typing import TypeVar

import torch
from numba import get_num_threads, set_num_threads

from stylesplat.rendering.kernels.jit import SHARED

T = TypeVar("T")
R = TypeVar("R")


def at_once(
    function: Callable[[T], R], items: Sequence[T], device: torch.device | str = "cpu"
) -> Generator[R]:
    """What a function makes of each item, in order; on the CPU of several items at a time.

    At most two results per core wait to be asked for, as they may be large.

    Args:
        function: Draws something by CPU kernels, for each item alone.
        items: What from.
        device: Where it works.
    """
    if len(items) == 0:
        return
    yield function(items[0])  # loads the kernels, once
    rest, threads = items[1:], get_num_threads()
    workers = min(threads, len(rest))
    if workers < 2 or torch.device(device).type != "cpu" or not SHARED:
        yield from map(function, rest)
        return
    pool = ThreadPoolExecutor(workers, "view", set_num_threads, (threads // workers,))
    try:
        yield from _in_order(pool, function, rest, 2 * workers)
    finally:
        pool.shutdown(cancel_futures=True)


def _in_order(
    pool: ThreadPoolExecutor, function: Callable[[T], R], items: Sequence[T], ahead: int
) -> Iterator[R]:
    enabled = torch.is_grad_enabled()  # which is each thread's own

    def work(item: T) -> R:
        with torch.set_grad_enabled(enabled):
            return function(item)

    left, waiting = iter(items), deque[Future[R]]()
    for item in islice(left, ahead):
        waiting.append(pool.submit(copy_context().run, work, item))
    while waiting:
        yield waiting.popleft().result()
        for item in islice(left, 1):
            waiting.append(pool.submit(copy_context().run, work, item))
