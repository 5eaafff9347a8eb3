"""A command that is killed leaves what was there, or what it was to write, and no half of it.

A kill ends a process between two calls to the file system: the folder is copied at each change.
"""

import os
import shutil
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

import stylesplat as ss
from balls import CAMERAS
from capture_files import write_ball_capture
from processes import run
from scenes import full_scene, plain_scene

CHANGES = {"os.rename", "os.link", "os.symlink", "os.mkdir", "os.rmdir", "os.remove"}
FOR_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
SELECT = ("--name", "x", "--id", "7", "--no-picture")
TRAIN = ("--steps", "2", "--test-every", "0", "--device", "cpu", "--overwrite")

_recorders: list[Callable[[Path | None], None]] = []


@cache
def listen() -> None:
    """Call the recorder at each change, from now on: an audit hook cannot be removed."""

    def hook(event: str, arguments: tuple) -> None:
        flags = arguments[2] if event == "open" and isinstance(arguments[2], int) else 0
        if _recorders and (event in CHANGES or flags & FOR_WRITING):
            recorder = _recorders.pop()  # whose own calls do not count
            recorder(Path(os.fsdecode(arguments[0])) if flags & os.O_TRUNC else None)
            _recorders.append(recorder)

    sys.addaudithook(hook)


def kills(write: Callable[[], object], folder: Path, copies: Path) -> list[Path]:
    """Copies of a folder as kills before each change, or once a file is opened, leave it."""
    made: list[Path] = []

    def copy(emptied: Path | None) -> None:
        made.append(copies / str(len(made)))
        shutil.copytree(folder, made[-1], symlinks=True)
        if emptied and emptied.is_relative_to(folder):
            (made[-1] / emptied.relative_to(folder)).write_bytes(b"")

    listen()
    _recorders.append(copy)
    try:
        write()
    finally:
        _recorders.clear()
    return made


def scene_of(folder: Path) -> object:
    try:
        scene = ss.open(folder)
    except ss.StyleSplatError as error:
        assert "There is no scene" in str(error)
        return None
    strengths = [(layer.object, layer.strength) for layer in scene.layers]
    return sorted(scene.objects), strengths, scene.splats.means.tolist(), len(scene.metrics)


def read(folder: Path) -> object:
    """What readers find of all that commands write."""
    scene, trained = scene_of(folder / "scene"), scene_of(folder / "trained")
    return scene, (folder / "a.ply").read_bytes(), trained is not None


COMMANDS: dict[str, Callable[[Path], object]] = {
    "save": lambda folder: ss.save(plain_scene(), folder / "scene", overwrite=True),
    "adjust": lambda folder: run("adjust", folder / "scene", "--intensity", "0.5"),
    "select": lambda folder: run("select", folder / "scene", *SELECT),
    "export": lambda folder: ss.export(plain_scene(), folder / "a.ply", overwrite=True),
    "train": lambda folder: run("train", folder / "capture", "-o", folder / "trained", *TRAIN),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_kill_leaves_the_old_or_the_new(name: str, tmp_path: Path):
    command, folder = COMMANDS[name], tmp_path / "work"
    ss.save(full_scene(), folder / "scene")
    ss.export(plain_scene().splats[:3], folder / "a.ply")
    write_ball_capture(folder / "capture", CAMERAS[:3])
    old = read(folder)
    left = kills(lambda: command(folder), folder, tmp_path / "kills")
    new = read(folder)
    assert old != new and len(left) > 3, "nothing was changed, or the calls were not seen"
    assert all(read(each) in (old, new) for each in left)
    command(left[-1])
    assert read(left[-1]) == new, "what a kill left must not disturb the next command"
