"""COLMAP reconstructions, binary or text."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float64, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap_check import check_complete
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.posed_files import PosedFiles
from stylesplat.io.files import is_file, reason

# All that pycolmap raises on bad files; a ValueError also for names that are not UTF-8
MALFORMED = (ValueError, IndexError, KeyError, TypeError, RuntimeError, OverflowError, MemoryError)


def find_sparse(folder: Path) -> Path | None:
    """The folder with the reconstruction of a capture, if it has one."""
    for sparse in (folder / "sparse" / "0", folder / "sparse"):
        tables = (sparse / f"cameras{suffix}" for suffix in (".bin", ".txt"))
        if any(map(is_file, tables)):
            return sparse
    return None


def read_colmap(folder: Path, sparse: Path) -> PosedFiles:
    """Read the poses, cameras and points of a capture; photos are sorted by name.

    Args:
        folder: The capture, with `images/` or `images_2/` and so on.
        sparse: The reconstruction inside it, as `find_sparse` finds it.

    Raises:
        StyleSplatError: If a file is missing, truncated or malformed, or no photo is posed.
    """
    check_complete(sparse)
    try:
        return _posed(pycolmap.Reconstruction(sparse), sparse, folder)
    except MALFORMED as error:
        raise StyleSplatError(
            f"Cannot read the reconstruction {sparse}: {reason(error)}. Copy it again."
        ) from error


def posed_images(model: pycolmap.Reconstruction) -> list[pycolmap.Image]:
    """The images that have a pose, sorted by name."""
    return sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name)


def viewmats_of(images: Sequence[pycolmap.Image]) -> Float64[Tensor, "C 4 4"]:
    """World to camera, of images that have a pose."""
    viewmats = torch.eye(4, dtype=torch.float64).repeat(len(images), 1, 1)
    viewmats[:, :3] = torch.from_numpy(np.stack([i.cam_from_world().matrix() for i in images]))
    return viewmats


def _posed(model: pycolmap.Reconstruction, sparse: Path, folder: Path) -> PosedFiles:
    images = posed_images(model)
    if not images:
        raise StyleSplatError(
            f"{sparse} has {model.num_cameras()} cameras and {model.num_images()} images, none of "
            "them posed. Run the reconstruction again."
        )
    lenses = {key: Lens.from_colmap(camera) for key, camera in model.cameras.items()}
    points, point_colors = _points(model)
    photos = find_photos(folder)
    return PosedFiles(
        names=tuple(image.name for image in images),
        paths=tuple(photos / image.name for image in images),
        lenses=tuple(lenses[image.camera_id] for image in images),
        viewmats=viewmats_of(images),
        points=points,
        point_colors=point_colors,
    )


def find_photos(folder: Path) -> Path:
    """The folder of a capture's photos: `images`, or the largest of the smaller copies.

    Raises:
        StyleSplatError: If there is neither.
    """
    if (folder / "images").is_dir():
        return folder / "images"
    copies = [p for p in folder.glob("images_*") if p.is_dir() and p.name[7:].isdecimal()]
    if not copies:
        raise StyleSplatError(f"{folder} has a reconstruction but no images/. Add the photos.")
    return min(copies, key=lambda p: int(p.name[7:]))


def _points(
    model: pycolmap.Reconstruction,
) -> tuple[Float[Tensor, "M 3"], UInt8[Tensor, "M 3"]] | tuple[None, None]:
    points = [point for _, point in sorted(model.points3D.items())]
    if not points:
        return None, None
    places = np.stack([point.xyz for point in points]).astype(np.float32)
    colors = np.stack([point.color for point in points]).astype(np.uint8)
    return torch.from_numpy(places), torch.from_numpy(colors)
