"""Settings of the process that make CPU steps several times faster, before torch is loaded."""

import ctypes
import os
from contextlib import suppress

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # names of glibc's mallopt
SPINS = "3000"  # of a thread before it sleeps: some microseconds
KEPT_BYTES = 2**30  # blocks up to this size are reused rather than given back


def tune_runtime() -> None:
    """Let idle threads sleep soon and freed memory be reused; settings of the environment stay.

    torch and numba each have a pool of OpenMP threads, and idle threads that spin take the cores
    from the other pool. Threads that sleep at once have to be woken for every small operation:
    painting takes a fifth longer, at the same processor time. glibc returns large blocks to the
    system at every free, so that the images of each step cost tens of thousands of page faults.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ.setdefault("GOMP_SPINCOUNT", SPINS)
    if "MALLOC_MMAP_THRESHOLD_" not in os.environ:
        try:
            mallopt = ctypes.CDLL(None).mallopt
        except (AttributeError, OSError, TypeError):  # not glibc
            return
        mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)


def tidy_heap() -> None:
    """Return freed memory to the system, which `tune_runtime` lets glibc keep."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
