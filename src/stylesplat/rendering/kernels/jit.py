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
from contextlib import suppress
from importlib import import_module
from typing import Any

import numba

from stylesplat.rendering.kernels.code_cache import keep
from stylesplat.rendering.kernels.compiling import announce_compilation

announce_compilation()  # whoever loads kernels may have to compile them

ONLY_PRANGE = {
    "prange": True,
    **dict.fromkeys(("comprehension", "reduction", "inplace_binop", "setitem"), False),
    **dict.fromkeys(("numpy", "stencil", "fusion"), False),
}


def cached(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` whose machine code is kept where that is possible; see `code_cache`."""
    compiled = numba.njit(**options)

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = compiled(function)
        keep(dispatcher, function)
        return dispatcher

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
