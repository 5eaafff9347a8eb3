"""The objects that painting is tried on, and the scenes that show them, made when they are needed.

Photos of real things are in the development data, the demo makes its own, and a face and a sign on
thin legs are traced (`traced_objects.py`). Every scene takes minutes, once.
"""

import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from bench import DATA
from fox_outlines import FOX, outline_mask
from torch import Tensor
from traced_objects import Shape, write_traced_capture

import stylesplat as ss
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import exact_masks
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, resize_labels
from stylesplat.scene.scene import Scene
from stylesplat.selection.resolve import whole_ids

DOLL = "doll=20240212_003919.jpg:295,130,830,670"
BY_HAND, EXACT = 6.0, 2.0  # pixels by which an outline may err

Outlines = tuple[list[tuple[Cameras, Tensor]], float]
"""Cameras and the object's pixels in them, and by how many pixels these may err."""


@dataclass(frozen=True)
class PaintedObject:
    """A thing to paint."""

    scene: str
    """The scene that shows it."""
    name: str
    """What it is called there: a name, or a label id."""


Name = Literal["fox", "plaque", "bottle", "keyboard", "doll", "vase", "teapot", "face", "sign"]
OBJECTS: Mapping[Name, PaintedObject] = {
    "fox": PaintedObject("fox", "1"),
    "plaque": PaintedObject("fox", "2"),
    "bottle": PaintedObject("desk", "1"),
    "keyboard": PaintedObject("desk", "4"),
    "doll": PaintedObject("doll", "doll"),
    "vase": PaintedObject("demo/scene", "vase"),
    "teapot": PaintedObject("demo/scene", "teapot"),
    "face": PaintedObject("face", "1"),
    "sign": PaintedObject("sign", "1"),
}


def find_scene(name: str, folder: Path) -> Scene:
    """A test scene, from a folder of them or made into it.

    Raises:
        FileNotFoundError: If its photos are not on this machine.
    """
    path = folder / name
    if not path.is_dir():
        MAKERS[name](folder)
    return ss.open(path)


def photos_of(scene: Scene) -> Capture | None:
    """The scene's capture with its exact label maps, if it has such; None if it is gone."""
    if scene.capture is None:
        return None
    try:
        masks = exact_masks(scene.capture)
        return ss.load(scene.capture, downscale=scene.downscale, masks=masks)
    except StyleSplatError:
        return None


def find_outlines(key: Name, scene: Scene, capture: Capture | None) -> Outlines | None:
    """Where an object exactly is, in some views; None if nobody knows."""
    test = OBJECTS[key]
    training, held_out = scene.working_views()
    if key == "fox":
        every = training if held_out is None else training + held_out
        cameras = [every[every.index(name)] for name in FOX]
        return [(c, outline_mask(c.names[0], c.size)) for c in cameras], BY_HAND
    if test.scene not in ("demo/scene", "face", "sign") or capture is None:
        return None
    ids = torch.tensor(whole_ids(scene, test.name))
    found, views = [], held_out or training
    for camera in (views[row] for row in range(len(views))):
        labels = capture.labels(capture.cameras.index(camera.names[0]))
        if labels is not None:
            inside = torch.isin(resize_labels(labels, camera.size[::-1]), ids)
            found += [(camera, inside)] if inside.any() else []
    return (found, EXACT) if found else None


def _fox(folder: Path) -> None:
    _stylesplat("train", _photos("fox"), "-o", folder / "fox", "--steps", 4000)


def _desk(folder: Path) -> None:
    _stylesplat("train", _photos("desk"), "-o", folder / "desk", "--steps", 4000)


def _doll(folder: Path) -> None:
    capture = folder / "doll_capture"
    _stylesplat("sfm", _photos("doll/photos"), "-o", capture, "--overwrite")
    _stylesplat("mask", capture, "--box", DOLL, "--overwrite")
    _stylesplat("train", capture, "-o", folder / "doll", "--steps", 3000)


def _demo(folder: Path) -> None:
    _stylesplat("demo", "-o", folder / "demo")


def _traced(shape: Shape) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        capture = folder / f"{shape}_capture"
        if not capture.is_dir():
            write_traced_capture(shape, capture)
        _stylesplat("train", capture, "-o", folder / shape, "--steps", 3000)

    return make


MAKERS: Mapping[str, Callable[[Path], None]] = {
    "fox": _fox,
    "desk": _desk,
    "doll": _doll,
    "demo/scene": _demo,
    "face": _traced("face"),
    "sign": _traced("sign"),
}


def _photos(name: str) -> Path:
    path = DATA / name
    if not path.is_dir():
        raise FileNotFoundError(f"{path} is not here")
    return path


def _stylesplat(*words: object) -> None:
    """A command line in a process of its own, which frees its memory."""
    subprocess.run([sys.executable, "-m", "stylesplat", *map(str, words)], check=True)
