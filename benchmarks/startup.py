"""What the compiled kernels add to a start: with an empty cache, and with a filled one.

    .venv/bin/python benchmarks/startup.py

Each start is a process of its own that imports the package and trains one joint step, then
another: the first contains loading or compiling of all kernels, the second does not.
"""

import json
import os
import subprocess
import sys
import tempfile

from bench import machine, table

START = """
import json, sys, time
begin = time.perf_counter()
import torch
imported_torch = time.perf_counter()
import stylesplat as ss
from stylesplat.demo.still_life import dome_cameras
from stylesplat.progress import Silence, listen
from stylesplat.scene.capture import Capture
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.loop import fit
imported = time.perf_counter()

class Lines(Silence):
    def say(self, line):
        print(line, file=sys.stderr)

listen(Lines())
capture = Capture(
    cameras=dome_cameras(2, 128, 96),
    photos=[torch.zeros(96, 128, 3, dtype=torch.uint8)] * 2,
    label_maps=[torch.zeros(96, 128, dtype=torch.int64)] * 2,
    points=torch.rand(500, 3),
)

def train():
    start = time.perf_counter()
    fit(capture, TrainConfig(steps=1, test_every=0))
    return time.perf_counter() - start

first, second = train(), train()
print(json.dumps([imported_torch - begin, imported - imported_torch, first - second]))
"""


def start(cache: str) -> tuple[list[float], str]:
    """Seconds of importing torch, of importing the package, and of kernels; and what it said."""
    done = subprocess.run(
        [sys.executable, "-c", START],
        env=os.environ | {"NUMBA_CACHE_DIR": cache},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout), done.stderr.strip()


def main() -> None:
    """Print the table."""
    print(machine())
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        for name in ("cold", "warm", "warm again"):
            seconds, said = start(cache)
            rows.append([name, *(f"{s:.1f} s" for s in seconds), said or "nothing"])
    print(table(["start", "import torch", "import stylesplat", "kernels", "says"], rows))


if __name__ == "__main__":
    main()
