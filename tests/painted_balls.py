"""The balls with named objects, and quick ways to paint them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from balls import CAMERAS, SPLATS
from stylesplat.io import scene_folder
from stylesplat.scene.compose import mask_of
from stylesplat.scene.layer import Layer
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import Splats
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.style import Style
from stylesplat.verbs.stylize import stylize_unmeasured

FAST = StyleConfig(steps=3, layers=(1,), object_size=30, intensity=0.6)
ROWS = torch.arange(len(SPLATS))
RED, GREEN, BLUE = ((ROWS >= start) & (ROWS < start + 80) for start in (200, 280, 360))
PICKS = {"red": RED, "green": GREEN, "blue": BLUE, "both": RED | GREEN}
TRAINED = Scene(
    splats=replace(
        SPLATS,
        shN=0.1 * torch.randn(len(SPLATS), 15, 3, generator=torch.Generator().manual_seed(0)),
        confidence=ROWS / len(SPLATS),
    ),
    cameras=CAMERAS,
    held_out=CAMERAS.names[:1],
    objects={name: SceneObject(picked, {"ids": []}) for name, picked in PICKS.items()},
    metrics={"psnr": 30.0},
)


def write_pictures(folder: Path) -> tuple[Path, Path]:
    """Two pictures to paint with."""
    generator = torch.Generator().manual_seed(1)
    paths = folder / "wave.png", folder / "night.png"
    for number, path in enumerate(paths):
        pixels = torch.rand(64, 80, 3, generator=generator) * torch.tensor([1, number, 0.5])
        Image.fromarray((255 * pixels).byte().numpy()).save(path)
    return paths


def painted(
    scene: Scene,
    name: str,
    pictures: Sequence[Path] | Path,
    network: Any = None,
    *,
    measured: bool = True,
    **settings: Any,
) -> Scene:
    """A scene with one more object painted."""
    pictures = [pictures] if isinstance(pictures, Path) else pictures
    style = Style(*pictures, config=FAST, **settings)
    done = stylize_unmeasured(scene, {name: style}, **(network or {}), device="cpu")
    return done.measured() if measured else done.scene


def write_painted(
    folder: Path, second: str, pictures: Callable[[Path, Path], Sequence[Path] | Path]
) -> Path:
    """The balls; red painted on a canvas, a second one on its own Gaussians; and two pictures.

    Args:
        folder: Gets `trained`, `once`, `twice` and the pictures.
        second: The object's name or id.
        pictures: What it is painted with, of the two.
    """
    wave, night = write_pictures(folder)
    scene_folder.save(TRAINED, folder / "trained")
    rest = {"measured": False}
    once = painted(opened(folder / "trained"), "red", wave, **rest)
    scene_folder.save(once, folder / "once")
    pictured = pictures(wave, night)
    twice = painted(opened(folder / "once"), second, pictured, quality="draft", **rest)
    scene_folder.save(twice, folder / "twice")
    return folder


def contents(folder: Path, *but: str) -> dict[str, bytes]:
    """The files of a scene, without some."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name not in but)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def opened(path: Path) -> Scene:
    return scene_folder.open(path)


def layer_of(scene: Scene, name: str) -> Layer:
    """The layer of an object."""
    (found,) = (layer for layer in scene.layers if layer.object == name)
    return found


def own_rows(scene: Scene, name: str) -> torch.Tensor:
    """The Gaussians of a scene that belong to what a layer covers."""
    return mask_of(layer_of(scene, name), scene)


def assert_same_layers(one: Scene, other: Scene) -> None:
    """To the bit."""
    assert len(one.layers) == len(other.layers)
    for mine, its in zip(one.layers, other.layers, strict=True):
        for name, value in vars(mine).items():
            found = getattr(its, name)
            if isinstance(value, torch.Tensor):
                assert torch.equal(value, found), name
            elif isinstance(value, Splats):
                assert_same_splats(value, found)
            else:
                assert value == found, name


def assert_same_splats(one: Splats, other: Splats) -> None:
    """To the bit."""
    assert one.tensors().keys() == other.tensors().keys()
    for name, tensor in one.tensors().items():
        assert torch.equal(tensor, other.tensors()[name]), name
    a, b = one.classifier, other.classifier
    assert (a is None) == (b is None)
    if a is not None and b is not None:
        assert a.ids == b.ids
        assert torch.equal(a.weight, b.weight) and torch.equal(a.bias, b.bias)


def assert_same_objects(one: Scene, other: Scene) -> None:
    """Names, Gaussians and how they were found."""
    assert one.objects.keys() == other.objects.keys()
    for name, each in one.objects.items():
        assert torch.equal(each.picked, other.objects[name].picked), name
        assert each.how == other.objects[name].how
