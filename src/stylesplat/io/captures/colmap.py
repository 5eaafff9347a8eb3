"""COLMAP reconstructions, binary or text."""

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.posed_files import PosedFiles
from stylesplat.io.files import is_there, open_binary, reading, require_regular
from stylesplat.io.kinds import find_sparse

if TYPE_CHECKING:  # else each command would load it
    from stylesplat.io.captures.colmap_library import pycolmap


def find_photos(folder: Path) -> Path:
    """The folder of a capture's photos: `images`, or the least reduced of `images_2` and so on."""
    folders = find_photo_folders(folder)
    if not folders:
        raise StyleSplatError(f"{folder} has a reconstruction but no images/. Add the photos.")
    return folders[0]


def find_photo_folders(folder: Path) -> list[Path]:
    """`images`, `images_2` and so on, as far as they are there, the least reduced first."""
    copies = [p for p in folder.glob("images_*") if p.is_dir() and p.name[7:].isdecimal()]
    whole = [folder / "images"] if (folder / "images").is_dir() else []
    return [*whole, *sorted(copies, key=lambda p: int(p.name[7:]))]


def read_colmap(folder: Path, sparse: Path) -> PosedFiles:
    """Read the poses, cameras and points of a capture; photos are sorted by name."""
    with _opened_model(sparse) as model:
        images = posed_images(model)
        if not images:
            raise StyleSplatError(
                f"{sparse} has {model.num_cameras()} cameras and {model.num_images()} images, none "
                "of them posed. Run the reconstruction again."
            )
        lenses = {key: Lens.from_colmap(camera) for key, camera in model.cameras.items()}
        points = [point for _, point in sorted(model.points3D.items())]
        means = np.array([point.xyz for point in points], np.float64)
        colors = np.array([point.color for point in points], np.uint8)
        photos = find_photos(folder)
        return PosedFiles(
            names=tuple(image.name for image in images),
            paths=tuple(photos / image.name for image in images),
            lenses=tuple(lenses[image.camera_id] for image in images),
            viewmats=viewmats_of(images),
            points=torch.from_numpy(means) if points else None,
            point_colors=torch.from_numpy(colors) if points else None,
        )


def posed_images(model: "pycolmap.Reconstruction") -> list["pycolmap.Image"]:
    return sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name)


def viewmats_of(images: Sequence["pycolmap.Image"]) -> Float64[Tensor, "C 4 4"]:
    viewmats = torch.eye(4, dtype=torch.float64).repeat(len(images), 1, 1)
    viewmats[:, :3] = torch.from_numpy(np.stack([i.cam_from_world().matrix() for i in images]))
    return viewmats


@dataclass(frozen=True)
class ModelFigures:
    """How well the photos of a reconstruction hold together."""

    error: float
    """Mean reprojection error in pixels."""
    track_length: float
    """Mean number of photos that a point was found in."""
    shared: dict[str, int]
    """Number of points by name of the photo."""


def read_figures(folder: Path) -> ModelFigures | None:
    """Read the figures of a capture; None without a COLMAP model, or if its points lack tracks."""
    sparse = find_sparse(folder)
    if sparse is None:
        return None
    with _opened_model(sparse) as model:
        if not model.compute_num_observations():
            return None
        return ModelFigures(
            error=model.compute_mean_reprojection_error(),
            track_length=model.compute_mean_track_length(),
            shared={i.name: i.num_points3D for i in model.images.values() if i.has_pose},
        )


@contextmanager
def _opened_model(sparse: Path) -> Iterator["pycolmap.Reconstruction"]:
    from stylesplat.io.captures.colmap_library import pycolmap

    check_complete(sparse)
    with reading(f"the reconstruction {sparse}", "Copy it again."):
        yield pycolmap.Reconstruction(sparse)


# pycolmap (4.2) does not notice where a binary file ends: it loads garbage from a truncated
# `cameras.bin`, and takes gigabytes for other files before it fails. So the lengths of the records
# (src/colmap/scene/reconstruction_io_binary.cc), and nothing else, are followed first.
COUNT, COUNT_32 = struct.Struct("<Q"), struct.Struct("<I")
CAMERA = struct.Struct("<IiQQ")  # id, model, width, height; then the parameters, float64
IMAGE_HEAD = 4 + 7 * 8 + 4  # id, pose, camera id; then the name, ended by a zero byte
POINT2D = 2 * 8 + 8  # x, y, point id
POINT3D_HEAD = 8 + 3 * 8 + 3 + 8  # id, position, colour, error
TRACK_ELEMENT = 4 + 4  # image id, index
RIG_HEAD = struct.Struct("<II")  # id, number of sensors
SENSOR = 4 + 4  # type, id
RIG_POSE = 7 * 8
FRAME_HEAD = 4 + 4 + 7 * 8  # id, rig id, pose
DATA_ID = SENSOR + 8


def check_complete(sparse: Path) -> None:
    """Raise a StyleSplatError if the records of a binary file do not end where the file does."""
    for kind in ("cameras", "images", "points3D", "rigs", "frames"):
        path = sparse / f"{kind}.bin"
        require_regular(path.with_suffix(".txt"))
        if is_there(path) and not _is_complete(path, kind):
            raise StyleSplatError(
                f"{path} is truncated or damaged: its records do not end where the file does. "
                "Copy it again."
            )


def _is_complete(path: Path, kind: str) -> bool:
    with open_binary(path) as file:
        try:
            with mmap(file.fileno(), 0, access=ACCESS_READ) as content:
                offset = COUNT.size
                for _ in range(COUNT.unpack_from(content)[0]):
                    offset = _end_of_record(kind, content, offset)
                    if offset > len(content):  # perhaps by more than an offset can be
                        return False
                return offset == len(content)
        except (struct.error, ValueError):  # the latter also of an empty file
            return False


def _end_of_record(kind: str, content: mmap, at: int) -> int:
    from stylesplat.io.captures.colmap_library import pycolmap

    count = COUNT  # of the list at the end of a record
    match kind:
        case "cameras":
            _, model, width, height = CAMERA.unpack_from(content, at)
            kind_of_lens = pycolmap.CameraModelId(model)
            camera = pycolmap.Camera.create_from_model_id(0, kind_of_lens, 1.0, width, height)
            return at + CAMERA.size + 8 * len(camera.params)
        case "rigs":
            _, sensors = RIG_HEAD.unpack_from(content, at)
            at += RIG_HEAD.size + SENSOR * (sensors > 0)  # the reference sensor has no pose
            for _ in range(sensors - 1):
                has_pose = content[at + SENSOR] if at + SENSOR < len(content) else 0
                at += SENSOR + 1 + RIG_POSE * (has_pose > 0)
                if at > len(content):
                    break
            return at
        case "images":
            start, item = content.find(b"\0", at + IMAGE_HEAD) + 1, POINT2D
            if not start:
                raise ValueError("a name without end")
        case "points3D":
            start, item = at + POINT3D_HEAD, TRACK_ELEMENT
        case _:  # frames
            start, item, count = at + FRAME_HEAD, DATA_ID, COUNT_32
    return start + count.size + item * count.unpack_from(content, start)[0]
