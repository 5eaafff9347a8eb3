"""COLMAP in this process: what most tests look at, without a process for each stage."""

from contextlib import redirect_stdout
from io import TextIOBase
from typing import Any

import pytest

from stylesplat.photo_libraries import pycolmap
from stylesplat.progress import Task, task
from stylesplat.structure_from_motion import workspace
from stylesplat.structure_from_motion.colmap_process import run_in_process


class _Counts(TextIOBase):
    """What a stage prints: how much of its work is done."""

    def __init__(self, bar: Task, done: int) -> None:
        self.bar, self.done = bar, done

    def write(self, text: str) -> int:
        if text.strip().isdecimal():
            self.bar.advance(max(0, int(text) - self.done))
            self.done = max(self.done, int(text))
        return len(text)


def run_stage_here(
    stage: str, settings: dict[str, Any], what: str, total: int, unit: str, done: int = 0
) -> None:
    """As `run_stage` does in a process of its own."""
    level = pycolmap.logging.minloglevel
    try:
        with task(what, total, unit=unit, done=done) as bar, redirect_stdout(_Counts(bar, done)):
            run_in_process(stage, settings | {"done": done})
    finally:
        pycolmap.logging.minloglevel = level


@pytest.fixture
def colmap_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workspace, "run_stage", run_stage_here)
