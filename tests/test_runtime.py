"""How threads of torch and of numba share the cores."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

COUNT = """
import os, torch
import stylesplat
print(len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted there")
def test_threads_of_a_torch_that_came_first_are_more_than_cores_so_that_they_sleep_soon():
    """GNU's OpenMP lets threads spin shortly as soon as they are more than the cores."""
    names = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "OMP_NUM_THREADS")
    environment = {name: value for name, value in os.environ.items() if name not in names}
    done = subprocess.run([sys.executable, "-c", COUNT], env=environment, capture_output=True)
    assert int(done.stdout) > len(os.sched_getaffinity(0)), done.stderr


BLOCKS = """
import os, resource, sys
import stylesplat, numpy
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
numpy.ones(2**24)
before = faults()
for _ in range(4):
    numpy.ones(2**24)
print(faults() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="malloc is glibc's")
def test_malloc_keeps_large_blocks_unless_the_environment_says_no():
    def faults(**settings: str) -> int:
        environment = {n: v for n, v in os.environ.items() if not n.startswith("MALLOC_")}
        done = subprocess.run(
            [sys.executable, "-c", BLOCKS], env={**environment, **settings}, capture_output=True
        )
        return int(done.stdout)

    assert faults() < faults(STYLESPLAT_KEEP_MALLOC="1") / 4
