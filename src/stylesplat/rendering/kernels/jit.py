"""How kernels are compiled: cached on disk, and with no more passes than they need.

numba compiles in front of a waiting user, so what does not help is left out: all parallel
transformations but `prange`, and the wrappers by which Python would call inner functions.

What belongs together is passed as a NamedTuple. A loop over `prange` may use those among the
arguments whose fields are no tuples (numba takes them apart and puts them together again), and any
that it makes itself. Arrays that it writes to are taken out of them in front of the loop.

Kernels that Python calls return numbers at most, and write into arrays that they are given: to
return an array or a NamedTuple numba unpickles its type, and an interruption at that moment (a
Ctrl-C that came while the kernel ran) is a segmentation fault.
"""

import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import cache
from importlib import import_module
from inspect import unwrap
from pathlib import Path
from typing import Any

import numba
from numba.core import event

from stylesplat.progress import say, uncounted

COMPILING = (
    "Compiling the CPU kernels for this processor. It takes up to a minute, once: later "
    "starts find them in the cache."
)
NO_CACHE = (
    "Neither the package's folder nor the home can be written to, so every start compiles the CPU "
    "kernels. Name a folder for them in NUMBA_CACHE_DIR."
)


class _Announcement(event.Listener):
    """Says a line when the first compilation of the process begins, and reports each as work.

    Compilations nest, and numba's lock keeps those of other threads apart.
    """

    said = False

    def __init__(self) -> None:
        self._under_way = list[ExitStack]()

    def on_start(self, event: event.Event) -> None:
        """Called before each compilation, but not when a kernel is loaded from the cache."""
        if not self.said and no_cache.cache_info().currsize == 0:
            say(COMPILING)
        self.said = True
        self._under_way.append(ExitStack())
        self._under_way[-1].enter_context(uncounted("compiling"))

    def on_end(self, event: event.Event) -> None:
        """Called after each compilation, also of one that failed."""
        self._under_way.pop().close()


@cache
def announce_compilation() -> None:
    """Say so in one line if kernels have to be compiled from now on."""
    event.register("numba:compile", _Announcement())


@cache
def no_cache() -> None:
    say(NO_CACHE)


@cache
def delete_stale_caches(folder: Path) -> None:
    """Delete cached kernels of a folder that are older than the newest source of what they take.

    numba unpickles an index before it compares it with the source. A type that was renamed since,
    as by an upgrade of the package, is an AttributeError then.
    """
    with suppress(OSError):
        own = Path(__file__).parent
        sources = own.parent / "reference.py", *own.glob("*.py"), *folder.glob("*.py")
        newest = max(each.stat().st_mtime for each in sources)
        for kernel in (folder / "__pycache__").glob("*.nb[ic]"):
            if kernel.stat().st_mtime < newest:
                kernel.unlink(missing_ok=True)


announce_compilation()  # whoever loads kernels may have to compile them

ONLY_PRANGE = {
    "prange": True,
    **dict.fromkeys(("comprehension", "reduction", "inplace_binop", "setitem"), False),
    **dict.fromkeys(("numpy", "stencil", "fusion"), False),
}


def cached(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with numba's cache on disk, or without where it finds no folder to write to."""

    def decorate(function: Callable[..., Any]) -> Any:
        function = unwrap(function)  # tests wrap every function to check types
        delete_stale_caches(Path(function.__code__.co_filename).parent)
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:  # numba has tried all places
            no_cache()
            return numba.njit(**options)(function)

    return decorate


def _threads_may_share() -> bool:
    """numba's own layer of threads ends the process if two threads call it; OpenMP's does not."""
    if any(name.startswith("NUMBA_THREADING_LAYER") for name in os.environ):
        return False  # it may be the one that was asked for
    with suppress(ImportError):  # as numba will do it
        return import_module("numba.np.ufunc.omppool") is not None
    return False


SHARED = _threads_may_share()
"""Whether several threads may call kernels at the same time: then these hold no lock."""
kernel = cached(parallel=ONLY_PRANGE, nogil=SHARED)
"""Decorator of functions that Python calls and that use `prange`."""
serial_kernel = cached(nogil=SHARED)
"""Decorator of functions that Python calls and that use one thread."""
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
inner = cached(**INNER)
"""Decorator of functions that only other kernels call."""
inlined = cached(**INNER, forceinline=True)
"""Decorator of inner functions that are too large for LLVM to inline by itself, and too hot."""
