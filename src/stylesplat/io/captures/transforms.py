"""`transforms.json`, the captures of instant-ngp and nerfstudio."""

import math
import os
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.captures.lens import MAX_SIDE, Lens
from stylesplat.io.captures.posed_files import PosedFiles, check_path
from stylesplat.io.files import reason
from stylesplat.io.images import image_sizes
from stylesplat.io.json_files import fitting, read_json
from stylesplat.io.kinds import TRANSFORMS
from stylesplat.io.ply import read_ply_table

XYZ = ("x", "y", "z")
RGB = ("red", "green", "blue")
EXTENSIONS = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")  # tried where a name has none
FISHEYE = "OPENCV_FISHEYE"
FRAME_MODELS = ("OPENCV", "FULL_OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
AGAIN = "Pose the photos again."
OPENGL_AXES = torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64)  # x right, y up, z back

Number = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
Side = Annotated[float, msgspec.Meta(ge=1, le=MAX_SIDE)]  # some programs write 1920.0
Row = Annotated[list[float], msgspec.Meta(min_length=4, max_length=4)]  # which may be NaN
Pose = Annotated[list[Row], msgspec.Meta(min_length=3, max_length=4)]


class _Frame(msgspec.Struct):
    """The entry of a photo, merged with the entries that apply to all."""

    file_path: str
    transform_matrix: Pose
    w: Side | None = None
    h: Side | None = None
    fl_x: Number | None = None
    fl_y: Number | None = None
    camera_angle_x: Number | None = None
    camera_angle_y: Number | None = None
    cx: Number | None = None
    cy: Number | None = None
    k1: Number = 0.0
    k2: Number = 0.0
    k3: Number = 0.0
    k4: Number = 0.0
    p1: Number = 0.0
    p2: Number = 0.0
    camera_model: str | None = None
    is_fisheye: bool = False


class _Transforms(msgspec.Struct):
    """The file, without the keys that a frame may have too."""

    frames: list[dict[str, Any]] = []
    ply_file_path: str | None = None


def read_transforms(folder: Path) -> PosedFiles:
    """Read poses and cameras, and the points where `ply_file_path` names some.

    Intrinsics may be given in each frame or once for all. Photos may lie anywhere; they are sorted
    by path, and named relative to their common folder.
    """
    path = folder / TRANSFORMS
    content = read_json(path)
    whole = fitting(content, _Transforms, f"{path} is malformed", AGAIN)
    if not whole.frames:
        raise StyleSplatError(f"{path} has no frames, so no cameras. Pose the photos again.")
    try:
        posed = [_read_frame(path, content | frame) for frame in whole.frames]
        points, point_colors = _read_points(folder, whole.ply_file_path)
    except (ValueError, RuntimeError, ArithmeticError) as error:
        raise StyleSplatError(f"{path} is malformed: {reason(error)}. {AGAIN}") from error
    posed.sort(key=lambda frame: _without_dots(frame[0]))
    paths, lenses, viewmats = zip(*posed, strict=True)
    plain = [_without_dots(path) for path in paths]
    common = Path(os.path.commonpath([photo.parent for photo in plain]))
    names = tuple(photo.relative_to(common).as_posix() for photo in plain)
    return PosedFiles(names, paths, lenses, torch.stack(viewmats), points, point_colors)


def _without_dots(path: Path) -> Path:
    return Path(os.path.normpath(path.absolute()))


def _read_frame(
    path: Path, content: dict[str, Any]
) -> tuple[Path, Lens | None, Float[Tensor, "4 4"]]:
    frame = fitting(content, _Frame, f"A frame of {path} is malformed", AGAIN)
    check_path(frame.file_path)
    photo = path.parent / frame.file_path
    candidates = [photo, *(photo.with_name(photo.name + extension) for extension in EXTENSIONS)]
    photo = next((candidate for candidate in candidates if candidate.is_file()), photo)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3] = torch.tensor(frame.transform_matrix[:3], dtype=torch.float64)
    # No error for a singular matrix: `load` names all bad poses at once
    return photo, _read_lens(frame, photo), torch.linalg.inv_ex(pose * OPENGL_AXES).inverse


def _read_lens(frame: _Frame, photo: Path) -> Lens | None:
    from stylesplat.io.captures.colmap_library import pycolmap

    if frame.w is None and not os.path.lexists(photo):
        return None
    if frame.w is None:
        width, height = image_sizes(photo)[1]
    elif frame.h is None:
        raise ValueError("it has w, but lacks the key 'h'")
    else:
        width, height = int(frame.w), int(frame.h)
    fx = _focal(frame.fl_x, frame.camera_angle_x, width, "x")
    fy = fx
    if frame.fl_y is not None or frame.camera_angle_y is not None:
        fy = _focal(frame.fl_y, frame.camera_angle_y, height, "y")
    cx = width / 2 if frame.cx is None else frame.cx
    cy = height / 2 if frame.cy is None else frame.cy
    pinhole, k = [fx, fy, cx, cy], (frame.k1, frame.k2, frame.k3, frame.k4)
    named = frame.camera_model or (FISHEYE if frame.is_fisheye else "OPENCV")
    if named == FISHEYE:
        model, params = FISHEYE, [*pinhole, *k]
    elif named in FRAME_MODELS and frame.k4 == 0:
        further = [frame.p1, frame.p2, frame.k3, 0.0, 0.0, 0.0]
        model, params = "FULL_OPENCV", [*pinhole, frame.k1, frame.k2, *further]
    else:
        raise ValueError(f"the camera model {brief(named)} with k4 = {frame.k4} is unknown")
    return Lens.from_colmap(pycolmap.Camera(model=model, width=width, height=height, params=params))


def _focal(focal: float | None, angle: float | None, side: int, axis: str) -> float:
    if focal is not None:
        return focal
    if angle is None:
        raise ValueError(f"it lacks the key 'fl_{axis}'")
    if not 0 < angle < math.pi:
        raise ValueError(f"camera_angle_{axis} cannot be {angle}")
    return side / (2 * math.tan(angle / 2))


def _read_points(
    folder: Path, name: str | None
) -> tuple[Float[Tensor, "M 3"], UInt8[Tensor, "M 3"]] | tuple[None, None]:
    if name is None:
        return None, None
    table = read_ply_table(folder / name)
    missing = {*XYZ, *RGB} - {*(table.dtype.names or ())}
    if missing:
        raise ValueError(f"the points {name} have no column {min(missing)}")
    with np.errstate(over="ignore", invalid="ignore"):  # PLY colours may be of any type
        xyz = np.stack([table[c].astype(np.float64) for c in XYZ], axis=1)
        colors = np.stack([table[c].astype(np.uint8) for c in RGB], axis=1)
    return torch.from_numpy(xyz), torch.from_numpy(colors)
