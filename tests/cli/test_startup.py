"""What the command line loads before it knows what is asked for."""

import os
import subprocess
import sys
from pathlib import Path

import stylesplat

PARSE = """
import contextlib, sys
from stylesplat.cli import main
with contextlib.suppress(SystemExit):
    main({arguments!r})
heavy = {{"torch", "numba", "cv2", "torchvision", "starlette"}}
print(*sorted(heavy & sys.modules.keys()))
"""


def loaded(*arguments: str) -> list[str]:
    """The slow modules that a call loads, in a process of its own."""
    script = PARSE.format(arguments=[*arguments])
    environment = {**os.environ, "PYTHONPATH": str(Path(stylesplat.__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1].split()


def test_help_does_not_load_torch():
    assert loaded("stylize", "--help") == []


def test_select_waits_for_nothing_but_torch(scene: Path):
    """Not for kernels, nor for what only detectors need."""
    ids = ("select", str(scene), "--name", "red", "--id", "3", "--no-picture")
    assert loaded(*ids) == ["torch"]
