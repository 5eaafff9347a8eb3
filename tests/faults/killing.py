"""Writers, and the folders that kills at each of their calls to the file system leave.

A kill before a call leaves what is on disk at that moment, so a copy is taken before each.
"""

import os
import shutil
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from unittest import mock

import torch

from full_scenes import contents, full_scene, plain_scene
from scenes import random_splats
from stylesplat.cli.train import Train
from stylesplat.errors import StyleSplatError
from stylesplat.io import atomic, scene_folder
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.photos import Photo
from stylesplat.io.label_maps import match_label_maps, write_label_maps
from stylesplat.io.view_files import write_views
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.compose import with_layers
from stylesplat.training import checkpoint, loop
from stylesplat.training.state import first_state
from stylesplat.training.train_config import TrainConfig
from stylesplat.verbs.export import export
from tiny_captures import write_capture

CHANGES = {"os.rename", "os.link", "os.symlink", "os.mkdir", "os.rmdir", "os.remove"}
FOR_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
SIDE = 4  # pixels


@dataclass(frozen=True)
class Writer:
    """What is written, in a folder of its own."""

    prepare: Callable[[Path], object]
    """What is there before."""
    write: Callable[[Path], object]
    """Takes its place."""
    read: Callable[[Path], object]
    """What a reader finds."""
    parts: bool = False
    """Whether readers take each file by itself, so that a mix is for the next writer to end."""


def kills(write: Callable[[Path], object], folder: Path, place: Path) -> list[Path]:
    """Copies of a folder as kills at each call to the file system would have left it."""
    copies: list[Path] = []

    def copy() -> None:
        copies.append(place / str(len(copies)))
        shutil.copytree(folder, copies[-1], symlinks=True)

    _listen()
    _recorders.append(copy)
    try:
        write(folder)
    finally:
        _recorders.clear()
    return copies


_recorders: list[Callable[[], None]] = []


@cache
def _listen() -> None:
    """Once and for all: such a hook cannot be taken away."""
    sys.addaudithook(_hook)


def _hook(event: str, arguments: tuple) -> None:
    if not _recorders:
        return
    writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & FOR_WRITING
    if writes or event in CHANGES:
        recorder = _recorders.pop()  # whose own calls do not count
        recorder()
        _recorders.append(recorder)


def faults(writer: Writer, folder: Path, whole: list[object]) -> list[str]:
    """What is wrong in the eyes of those who come after a kill.

    Args:
        writer: What was killed.
        folder: What it left.
        whole: What readers may find: the old, the new.
    """
    found = list[str]()
    try:
        read = writer.read(folder)
        if read not in whole and not writer.parts:
            found.append(f"neither the old nor the new: {read}")
        writer.write(folder)
        if writer.read(folder) != whole[1]:
            found.append("the next write does not give the new")
    except Exception:
        found.append(traceback.format_exc())
    return found


def visible(folder: Path) -> dict[str, bytes]:
    return {name: each for name, each in contents(folder).items() if not name.startswith(".")}


# Scenes


def read_scene(folder: Path) -> object:
    try:
        scene_folder.open(folder / "scene")
    except StyleSplatError as error:
        assert "There is no scene" in str(error)
        return None
    return visible(folder / "scene")


def save_first(folder: Path) -> None:
    scene_folder.save(full_scene(), folder / "scene")
    (folder / "scene" / "notes.txt").write_text("mine")


def save_second(folder: Path) -> None:
    scene_folder.save(plain_scene(), folder / "scene", overwrite=True)


def revise(folder: Path) -> None:
    scene = scene_folder.open(folder / "scene")
    changed = replace(with_layers(scene, ()), splats=plain_scene().splats, metrics={"psnr": 2.0})
    scene_folder.revise(scene, changed, folder / "scene")


def standing_in(write: Callable[[Path], object]) -> Callable[[Path], None]:
    """Write while one stands in the folder, which so must stay the same."""

    def there(folder: Path) -> None:
        before = Path.cwd()
        os.chdir(folder / "scene")
        try:
            write(folder)
        finally:
            os.chdir(before)

    return there


def without(name: str, write: Callable[[Path], object]) -> Callable[[Path], None]:
    """Write where the file system lacks something."""

    def there(folder: Path) -> None:
        with mock.patch.object(atomic, name, lambda *paths: False):
            write(folder)

    return there


# Label maps, views, splats, checkpoints


def few_cameras() -> Cameras:
    return Cameras(
        viewmats=torch.eye(4).expand(3, 4, 4).clone(),
        Ks=torch.eye(3).expand(3, 3, 3).clone(),
        sizes=torch.full((3, 2), SIDE),
        names=("a.png", "sub/b.png", "c.png"),
    )


def write_labels(folder: Path, *, ids: tuple[int | None, ...], names: dict[int, str]) -> None:
    maps = [None if id is None else torch.full((SIDE, SIDE), id) for id in ids]
    photos = [torch.zeros(SIDE, SIDE, 3, dtype=torch.uint8)] * len(maps)
    capture = Capture(few_cameras(), photos, maps, object_names=names)
    write_label_maps(capture, folder / "object_mask", overwrite=True)


def first_labels(folder: Path) -> None:
    write_labels(folder, ids=(1, 2, None), names={1: "vase"})
    (folder / "object_mask" / "notes.txt").write_text("mine")


def read_labels(folder: Path) -> object:
    lens = Lens("PINHOLE", SIDE, SIDE, (1.0, 1.0, 2.0, 2.0))
    names = few_cameras().names
    photos = [Photo(Path(name), True, lens, (SIDE, SIDE)) for name in names]
    maps = match_label_maps(folder / "object_mask", names, photos)
    seen = [None if labels is None else labels.tolist() for labels in maps]
    return seen, visible(folder / "object_mask")


def views(folder: Path, *, level: int) -> None:
    pictures = [torch.full((2, 2, 3), level, dtype=torch.uint8)] * 2
    write_views(["a.png", "sub/b.png"], pictures, folder / "views", overwrite=True)


def run_checkpoint(folder: Path) -> checkpoint.Checkpoint:
    return checkpoint.Checkpoint(folder / "run" / "checkpoint.pt", TrainConfig(), "photos=1")


def write_checkpoint(folder: Path, *, step: int) -> None:
    place = run_checkpoint(folder)
    for draft in place.path.parent.glob(".*"):  # as the command deletes the folder of a run
        draft.unlink()
    begun = first_state(replace(random_splats(5), identities=None))
    checkpoint.save_checkpoint(place, replace(begun, step=step))


def read_checkpoint(folder: Path) -> object:
    return checkpoint.load_checkpoint(run_checkpoint(folder), torch.device("cpu")).step


# A run as a whole, whose steps only count


def train(folder: Path) -> None:
    def step(run, state):
        return replace(state, step=state.step + 1), torch.zeros(2)

    run = Train(folder / "capture", folder / "scene", steps=2, test_every=0, device="cpu")
    with (
        mock.patch.object(loop, "train_step", step),
        mock.patch.object(loop, "warm_up", lambda *_: None),
        mock.patch.object(checkpoint, "CHECKPOINT_SECONDS", -1.0),
    ):
        replace(run, overwrite=True).run()


def read_trained(folder: Path) -> object:
    """The scene, if there is one yet, without what differs from run to run."""
    try:
        scene = scene_folder.open(folder / "scene")
    except StyleSplatError:
        return None
    return scene.metrics["steps"], scene.splats.means.tolist()


SAVED = partial(Writer, save_first, read=read_scene)
WRITERS = {
    "save new": Writer(lambda folder: None, save_second, read_scene),
    "save": SAVED(save_second),
    "revise": SAVED(revise),
    "label maps": Writer(
        first_labels, partial(write_labels, ids=(3, None, 4), names={}), read_labels
    ),
    "views": Writer(
        partial(views, level=1),
        partial(views, level=2),
        lambda folder: visible(folder / "views"),
        parts=True,
    ),
    "export": Writer(
        lambda folder: export(random_splats(5), folder / "a.ply"),
        lambda folder: export(random_splats(6), folder / "a.ply", overwrite=True),
        lambda folder: (folder / "a.ply").read_bytes(),
    ),
    "checkpoint": Writer(
        partial(write_checkpoint, step=1), partial(write_checkpoint, step=2), read_checkpoint
    ),
    "train": Writer(lambda folder: write_capture(folder / "capture"), train, read_trained),
}
