"""Tiny COLMAP captures, made by pycolmap and Pillow."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.posed_files import PosedFiles

WIDTH, HEIGHT = 64, 48
PINHOLE = ("PINHOLE", (60.0, 62.0, 31.0, 25.0))


def save_noise(path: Path, size: tuple[int, int] = (WIDTH, HEIGHT), seed: int = 0) -> None:
    pixels = np.random.default_rng(seed).integers(0, 256, (size[1], size[0], 3), np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def reconstruction(model: str, params: Sequence[float], count: int) -> pycolmap.Reconstruction:
    """Cameras one unit apart along x, looking along z; four points at depth 5."""
    result = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=params, camera_id=1)
    result.add_camera_with_trivial_rig(camera)
    for i in range(count):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([-float(i), 0.0, 0.0]))
        name = f"{count - i:03d}.png"  # ids run against the names
        image = pycolmap.Image(name=name, camera_id=1, image_id=i + 1)
        result.add_image_with_trivial_frame(image, pose)
    for i in range(4):
        color = np.array([10 * i, 20, 30], np.uint8)
        result.add_point3D(np.array([i, 0.5, 5.0]), pycolmap.Track(), color)
    return result


def write_capture(
    folder: Path,
    model: str = PINHOLE[0],
    params: Sequence[float] = PINHOLE[1],
    *,
    count: int = 3,
    text: bool = False,
    sparse: str = "sparse/0",
    images: str = "images",
) -> Path:
    """Write a reconstruction and photos of noise, and return the folder."""
    (folder / sparse).mkdir(parents=True)
    posed = reconstruction(model, params, count)
    (posed.write_text if text else posed.write)(folder / sparse)
    for i in range(count):
        save_noise(folder / images / f"{i + 1:03d}.png", seed=i)
    return folder


def lenses_of(posed: PosedFiles) -> list[Lens]:
    """The lenses of photos that all have one."""
    return [lens for lens in posed.lenses if lens is not None]
