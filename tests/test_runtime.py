"""How threads of torch and of numba share the cores."""

import os
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
