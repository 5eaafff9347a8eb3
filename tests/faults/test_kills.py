"""Kills: what is on disk is the old or the new, and the next one who comes cleans up."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import stylesplat
from full_scenes import full_scene
from killing import WRITERS, faults, kills
from stylesplat.cli.select import Select
from stylesplat.io import atomic
from stylesplat.io.scene_folder import open, save
from stylesplat.progress import Silence, observed

LEAST = {"export": 6, "checkpoint": 3, "views": 15}  # calls at which a writer can be killed
USUAL = 20  # of the others


@pytest.fixture
def no_fsync(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes long, and only power cuts need it."""
    monkeypatch.setattr(os, "fsync", lambda file: None)


@pytest.mark.parametrize("name", WRITERS)
def test_a_kill_leaves_the_old_or_the_new(name: str, tmp_path: Path, no_fsync: None):
    writer, folder = WRITERS[name], tmp_path / "work"
    folder.mkdir()
    writer.prepare(folder)
    whole = [writer.read(folder)]
    left = kills(writer.write, folder, tmp_path / "kills")
    whole.append(writer.read(folder))
    assert whole[0] != whole[1]
    assert len(left) >= LEAST.get(name, USUAL), "the calls were not seen"
    wrong = {place.name: found for place in left if (found := faults(writer, place, whole))}
    assert not wrong


SELECT = """
import sys
from pathlib import Path
from stylesplat.cli.select import Select
from stylesplat.io import scene_folder

def late(*arguments, revise=scene_folder.revise):
    print("opened", flush=True)
    input()
    revise(*arguments)

scene_folder.revise = late
Select._draw = lambda self, scene, target: None  # which takes long
Select(Path(sys.argv[1]), "one", sphere=("0,0,0,9",)).run()
"""


def test_two_selections_at_once_are_both_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(atomic, "PATIENCE", 100.0)  # this machine may be busy
    save(full_scene(), tmp_path / "scene")
    first = subprocess.Popen(
        [sys.executable, "-c", SELECT, tmp_path / "scene"],
        env={**os.environ, "PYTHONPATH": str(Path(stylesplat.__file__).parents[1])},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    told: list[str] = []

    class Listener(Silence):
        def say(self, line: str) -> None:
            if line.startswith("Waiting for another stylesplat that chan"):
                told.append(line)
                first.communicate("go\n")

    assert first.stdout is not None and first.stdout.readline() == "opened\n"
    with observed(Listener()):
        Select(tmp_path / "scene", "other", sphere=("0,0,0,9",)).run()
    first.communicate("go\n" if not told else None)
    assert first.returncode == 0
    assert {"one", "other"} <= open(tmp_path / "scene").objects.keys()
    assert len(told) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"scene"}
