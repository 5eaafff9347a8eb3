"""`transforms.json`, the captures of instant-ngp and nerfstudio."""

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.photos import photo_sizes
from stylesplat.io.captures.posed_files import PosedFiles
from stylesplat.io.files import reason
from stylesplat.io.json_files import read_json, write_json
from stylesplat.io.ply import read_ply_table, write_ply_table
from stylesplat.scene.cameras import Cameras

TRANSFORMS = "transforms.json"
POINTS = "points.ply"
PLACE = ("x", "y", "z")
COLOR = ("red", "green", "blue")
EXTENSIONS = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")  # tried where a name has none
FISHEYE = "OPENCV_FISHEYE"
FRAME_MODELS = ("OPENCV", "FULL_OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
OPENGL_AXES = torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64)  # x right, y up, z back


def read_transforms(folder: Path) -> PosedFiles:
    """Read poses and cameras, and the points where `ply_file_path` names some.

    Intrinsics may stand in each frame or once for all. Photos are sorted by path.

    Raises:
        StyleSplatError: If the file is malformed, lacks a key or has no frames.
    """
    path = folder / TRANSFORMS
    content = read_json(path)
    frames = content.pop("frames", None)
    if not frames:
        raise StyleSplatError(f"{path} has no frames, so no cameras. Pose the photos again.")
    try:
        posed = sorted((_read_frame(folder, content | f) for f in frames), key=lambda f: f[0])
        points, point_colors = _read_points(folder, content.get("ply_file_path"))
    except KeyError as error:
        raise StyleSplatError(f"{path} lacks the key {error}. Pose the photos again.") from error
    except (TypeError, ValueError, RuntimeError, ArithmeticError) as error:
        raise StyleSplatError(f"{path} is malformed: {reason(error)}. Pose them again.") from error
    paths, lenses, viewmats = zip(*posed, strict=True)
    common = Path(os.path.commonpath([photo.parent for photo in paths]))
    names = tuple(photo.relative_to(common).as_posix() for photo in paths)
    return PosedFiles(names, paths, lenses, torch.stack(viewmats), points, point_colors)


def write_transforms(
    cameras: Cameras,
    folder: Path | str,
    *,
    photos: str = "images",
    points: Float[Tensor, "M 3"] | None = None,
    point_colors: UInt8[Tensor, "M 3"] | None = None,
) -> None:
    """Write `transforms.json`, and the points beside it if there are any.

    Args:
        cameras: The cameras of the photos.
        folder: The capture's folder.
        photos: Where in it the photos lie, under the cameras' names.
        points: Sparse points to start training from.
        point_colors: Their colours, grey by default.

    Raises:
        StyleSplatError: If a file cannot be written.
    """
    folder = Path(folder)
    content: dict[str, Any] = {"camera_model": "OPENCV"}
    if points is not None:
        _write_points(points, point_colors, folder / POINTS)
        content["ply_file_path"] = POINTS
    poses = torch.linalg.inv(cameras.viewmats.cpu().double()) * OPENGL_AXES
    content["frames"] = [
        {"file_path": f"{photos}/{name}", **_intrinsics(K, size), "transform_matrix": pose}
        for name, K, size, pose in zip(
            cameras.names, cameras.Ks.tolist(), cameras.sizes.tolist(), poses.tolist(), strict=True
        )
    ]
    write_json(content, folder / TRANSFORMS)


def _read_frame(folder: Path, frame: dict[str, Any]) -> tuple[Path, Lens, Float[Tensor, "4 4"]]:
    photo = _find_photo(folder / frame["file_path"])
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3] = torch.tensor(frame["transform_matrix"], dtype=torch.float64)[:3]
    # Without an error for what is no pose: `load` names all that are none
    return photo, _read_lens(frame, photo), torch.linalg.inv_ex(pose * OPENGL_AXES).inverse


def _find_photo(path: Path) -> Path:
    candidates = [path, *(path.with_name(path.name + extension) for extension in EXTENSIONS)]
    return next((p for p in candidates if p.is_file()), path)


def _read_lens(frame: dict[str, Any], photo: Path) -> Lens:
    width, height = (frame["w"], frame["h"]) if "w" in frame else photo_sizes(photo)[1]
    fx = _focal(frame, "x", width)
    fy = _focal(frame, "y", height) if {"fl_y", "camera_angle_y"} & frame.keys() else fx
    pinhole = [fx, fy, frame.get("cx", width / 2), frame.get("cy", height / 2)]
    k1, k2, k3, k4, p1, p2 = (frame.get(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    named = frame.get("camera_model", FISHEYE if frame.get("is_fisheye") else "OPENCV")
    if named == FISHEYE:
        model, params = FISHEYE, [*pinhole, k1, k2, k3, k4]
    elif named in FRAME_MODELS and k4 == 0:
        model, params = "FULL_OPENCV", [*pinhole, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
    else:
        raise ValueError(f"cameras of the model {named} with k4 = {k4} are not supported")
    return Lens.from_colmap(
        pycolmap.Camera(model=model, width=int(width), height=int(height), params=params)
    )


def _focal(frame: dict[str, Any], axis: str, side: int) -> float:
    angle = frame.get(f"camera_angle_{axis}")
    if f"fl_{axis}" in frame or angle is None:
        return float(frame[f"fl_{axis}"])
    return side / (2 * math.tan(angle / 2))


def _intrinsics(K: list[list[float]], size: list[int]) -> dict[str, int | float]:
    (fx, _, cx), (_, fy, cy), _ = K
    return {"w": size[0], "h": size[1], "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}


def _read_points(
    folder: Path, name: str | None
) -> tuple[Float[Tensor, "M 3"], UInt8[Tensor, "M 3"]] | tuple[None, None]:
    if name is None:
        return None, None
    table = read_ply_table(folder / name)
    missing = {*PLACE, *COLOR} - {*(table.dtype.names or ())}
    if missing:
        raise ValueError(f"the points {name} have no column {min(missing)}")
    places = np.stack([table[c].astype(np.float32) for c in PLACE], axis=1)
    colors = np.stack([table[c].astype(np.uint8) for c in COLOR], axis=1)
    return torch.from_numpy(places), torch.from_numpy(colors)


def _write_points(
    points: Float[Tensor, "M 3"], colors: UInt8[Tensor, "M 3"] | None, path: Path
) -> None:
    grey = torch.full(points.shape, 128, dtype=torch.uint8)
    rows = np.empty(len(points), [(c, "<f4") for c in PLACE] + [(c, "u1") for c in COLOR])
    for axis, (place, color) in enumerate(zip(PLACE, COLOR, strict=True)):
        rows[place] = points[:, axis].cpu().numpy()
        rows[color] = (grey if colors is None else colors.cpu())[:, axis].numpy()
    write_ply_table(rows, path)
