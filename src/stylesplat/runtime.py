"""Settings of the process that make CPU steps several times faster, before torch is loaded."""

import ctypes
import os
import sys
from contextlib import suppress
from threading import Event, Thread
from types import ModuleType

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # names of glibc's mallopt
SPINS = "3000"  # of a thread before it sleeps: some microseconds
PARALLEL = 2**20  # numbers, of which torch computes with in parallel
KEPT_BYTES = 2**30  # blocks up to this size are reused rather than given back
KEEP_MALLOC = "STYLESPLAT_KEEP_MALLOC"  # environment variable: 1 leaves glibc's malloc alone


def tune_runtime() -> None:
    """Let idle threads sleep soon and freed memory be reused; settings of the environment stay.

    torch and numba each have a pool of OpenMP threads, and idle threads that spin take the cores
    from the other pool. Threads that sleep at once have to be woken for every small operation:
    painting takes a fifth longer, at the same processor time. glibc returns large blocks to the
    system at every free, so that the images of each step cost tens of thousands of page faults.
    malloc belongs to the whole process: a program that imports the package sets the environment
    variable STYLESPLAT_KEEP_MALLOC to 1, or MALLOC_MMAP_THRESHOLD_ to its own, to keep it as it is.
    """
    torch = sys.modules.get("torch")
    if torch is not None and not {"OMP_WAIT_POLICY", "GOMP_SPINCOUNT"} & os.environ.keys():
        _shorten_spins(torch)  # it has read the environment already
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ.setdefault("GOMP_SPINCOUNT", SPINS)
    if "MALLOC_MMAP_THRESHOLD_" not in os.environ and os.environ.get(KEEP_MALLOC, "0") in ("", "0"):
        try:
            mallopt = ctypes.CDLL(None).mallopt
        except (AttributeError, OSError, TypeError):  # not glibc
            return
        mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)


def _shorten_spins(torch: ModuleType) -> None:
    """Let idle threads of torch sleep soon, also if torch was loaded before.

    GNU's OpenMP takes its threads to spin 300 times shorter as soon as it has started more of them
    than there are cores. Each thread that computes in parallel has a pool of its own, so a second
    one that waits for ever does that. Without it painting takes ten times as long on a busy
    machine.
    """
    done = Event()

    def hold_pool() -> None:
        torch.zeros(PARALLEL).add_(1)
        done.set()
        Event().wait()

    Thread(target=hold_pool, daemon=True, name="stylesplat-openmp").start()
    done.wait()


def tidy_heap() -> None:
    """Return freed memory to the system, which `tune_runtime` lets glibc keep."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
