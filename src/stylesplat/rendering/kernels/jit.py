"""How kernels are compiled: cached on disk, and with no more passes than they need.

numba compiles in front of a waiting user, so what does not help is left out: all parallel
transformations but `prange`, and the wrappers by which Python would call inner functions.

What belongs together is passed as a NamedTuple. A loop over `prange` may use those among the
arguments whose fields are no tuples (numba takes them apart and puts them together again), and any
that it makes itself. Arrays that it writes to are taken out of them in front of the loop.
"""

# pyright: reportArgumentType=false, reportCallIssue=false
# (numba's stubs know `parallel` as a boolean only)

import numba

ONLY_PRANGE = {
    "prange": True,
    **dict.fromkeys(("comprehension", "reduction", "inplace_binop", "setitem"), False),
    **dict.fromkeys(("numpy", "stencil", "fusion"), False),
}

kernel = numba.njit(cache=True, parallel=ONLY_PRANGE)
"""Decorator of functions that Python calls and that use `prange`."""
serial_kernel = numba.njit(cache=True)
"""Decorator of functions that Python calls and that use one thread."""
INNER = {"cache": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
inner = numba.njit(**INNER)
"""Decorator of functions that only other kernels call."""
inlined = numba.njit(**INNER, forceinline=True)
"""Decorator of inner functions that are too large for LLVM to inline by itself, and too hot."""
