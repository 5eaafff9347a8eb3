"""COLMAP reconstructions, binary or text."""

import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float64, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.posed_files import PosedFiles
from stylesplat.io.files import cannot_read, reason, require_regular
from stylesplat.io.kinds import find_sparse

# All that pycolmap raises on damaged files; ValueError also for names that are not UTF-8
MALFORMED = (ValueError, IndexError, KeyError, TypeError, RuntimeError, OverflowError, MemoryError)


def find_photos(folder: Path) -> Path:
    """The folder of a capture's photos: `images`, or the least reduced of `images_2` and so on."""
    if (folder / "images").is_dir():
        return folder / "images"
    copies = [p for p in folder.glob("images_*") if p.is_dir() and p.name[7:].isdecimal()]
    if not copies:
        raise StyleSplatError(f"{folder} has a reconstruction but no images/. Add the photos.")
    return min(copies, key=lambda p: int(p.name[7:]))


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


def posed_images(model: pycolmap.Reconstruction) -> list[pycolmap.Image]:
    """The images that have a pose, sorted by name."""
    return sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name)


def viewmats_of(images: Sequence[pycolmap.Image]) -> Float64[Tensor, "C 4 4"]:
    """The world-to-camera matrices of images that have a pose."""
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
def _opened_model(sparse: Path) -> Iterator[pycolmap.Reconstruction]:
    check_complete(sparse)
    try:
        yield pycolmap.Reconstruction(sparse)
    except MALFORMED as error:
        raise StyleSplatError(
            f"Cannot read the reconstruction {sparse}: {reason(error)}. Copy it again."
        ) from error


def _points(
    model: pycolmap.Reconstruction,
) -> tuple[Float[Tensor, "M 3"], UInt8[Tensor, "M 3"]] | tuple[None, None]:
    points = [point for _, point in sorted(model.points3D.items())]
    if not points:
        return None, None
    means = np.stack([point.xyz for point in points]).astype(np.float32)
    colors = np.stack([point.color for point in points]).astype(np.uint8)
    return torch.from_numpy(means), torch.from_numpy(colors)


# pycolmap (4.2) does not notice where a binary file ends: it loads garbage from a truncated
# `cameras.bin`, and takes gigabytes for other files before it fails. So the lengths of the records
# (src/colmap/scene/reconstruction_io_binary.cc), and nothing else, are followed first.
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
COUNT = struct.Struct("<Q")
FRAME_COUNT = struct.Struct("<I")


def check_complete(sparse: Path) -> None:
    """Raise a StyleSplatError if the records of a binary file do not end where the file does."""
    for name, skip in SKIPPERS.items():
        path = sparse / f"{name}.bin"
        require_regular(path)
        require_regular(path.with_suffix(".txt"))
        if path.exists() and not _is_complete(path, skip):
            raise StyleSplatError(
                f"{path} is truncated or damaged: its records do not end where the file does. "
                "Copy it again."
            )


def _is_complete(path: Path, skip: Callable[[mmap, int], int]) -> bool:
    try:
        with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as content:
            (count,) = COUNT.unpack_from(content)
            offset = COUNT.size
            for _ in range(count):
                offset = skip(content, offset)
                if offset > len(content):  # perhaps by more than an offset can be
                    return False
            return offset == len(content)
    except (struct.error, ValueError):  # the latter also of an empty file
        return False
    except OSError as error:
        raise cannot_read(path, error) from error


def _skip_camera(content: mmap, offset: int) -> int:
    _, model, width, height = CAMERA.unpack_from(content, offset)
    camera = pycolmap.Camera.create_from_model_id(
        0, pycolmap.CameraModelId(model), 1.0, width, height
    )
    return offset + CAMERA.size + 8 * len(camera.params)


def _skip_image(content: mmap, offset: int) -> int:
    end = content.find(b"\0", offset + IMAGE_HEAD) + 1
    if not end:
        raise ValueError("a name without end")
    return end + COUNT.size + POINT2D * COUNT.unpack_from(content, end)[0]


def _skip_point(content: mmap, offset: int) -> int:
    end = offset + POINT3D_HEAD
    return end + COUNT.size + TRACK_ELEMENT * COUNT.unpack_from(content, end)[0]


def _skip_rig(content: mmap, offset: int) -> int:
    _, sensors = RIG_HEAD.unpack_from(content, offset)
    offset += RIG_HEAD.size + SENSOR * (sensors > 0)  # the reference sensor has no pose
    for _ in range(sensors - 1):
        (has_pose,) = struct.unpack_from("<B", content, offset + SENSOR)
        offset += SENSOR + 1 + RIG_POSE * (has_pose > 0)
    return offset


def _skip_frame(content: mmap, offset: int) -> int:
    end = offset + FRAME_HEAD
    return end + FRAME_COUNT.size + DATA_ID * FRAME_COUNT.unpack_from(content, end)[0]


SKIPPERS = {
    "cameras": _skip_camera,
    "images": _skip_image,
    "points3D": _skip_point,
    "rigs": _skip_rig,
    "frames": _skip_frame,
}
