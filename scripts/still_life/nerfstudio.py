"""Captures in the layout of nerfstudio: `transforms.json`, and points beside it."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.io.captures.posed_files import RGB, XYZ
from stylesplat.io.captures.transforms import OPENGL_AXES
from stylesplat.io.json_yaml import write_json
from stylesplat.io.kinds import TRANSFORMS
from stylesplat.io.ply import write_ply_rows
from stylesplat.scene.cameras import Cameras

POINTS = "points.ply"


def write_transforms(
    cameras: Cameras,
    folder: Path | str,
    *,
    photos: str = "images",
    points: Float[Tensor, "M 3"] | None = None,
    point_colors: UInt8[Tensor, "M 3"] | None = None,
) -> None:
    """Write `transforms.json` into a capture's folder, and sparse points beside it.

    `photos` is the subfolder of the photos, whose names are those of the cameras; points without
    colours become grey.
    """
    folder = Path(folder)
    content: dict[str, Any] = {"camera_model": "OPENCV"}
    if points is not None:
        rows = np.empty(len(points), [(c, "<f4") for c in XYZ] + [(c, "u1") for c in RGB])
        for axis, (coordinate, color) in enumerate(zip(XYZ, RGB, strict=True)):
            rows[coordinate] = points[:, axis].cpu().numpy()
            rows[color] = 128 if point_colors is None else point_colors[:, axis].cpu().numpy()
        write_ply_rows(folder / POINTS, len(rows), rows.dtype, [rows])
        content["ply_file_path"] = POINTS
    poses = torch.linalg.inv(cameras.viewmats.cpu().double()) * OPENGL_AXES
    content["frames"] = [
        {
            "file_path": f"{photos}/{name}",
            **{"w": width, "h": height, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy},
            "transform_matrix": pose,
        }
        for name, ((fx, _, cx), (_, fy, cy), _), (width, height), pose in zip(
            cameras.names, cameras.Ks.tolist(), cameras.sizes.tolist(), poses.tolist(), strict=True
        )
    ]
    write_json(content, folder / TRANSFORMS)
