"""All cameras of a scene, as JSON: its numbers hold float32 exactly."""

from pathlib import Path
from typing import Annotated, Literal

import msgspec
import torch
from msgspec import Meta

from stylesplat.errors import StyleSplatError
from stylesplat.io.json_files import PhotoName, fitting, read_json_as, write_json
from stylesplat.scene.cameras import ROTATION_TOLERANCE, Cameras, are_rigid

MAX_PIXELS = 2**28  # of a view: larger renders do not fit into memory
REMEDY = "Train again."

_Side = Annotated[int, Meta(ge=1, le=0xFFFF)]
_Focal = Annotated[float, Meta(ge=1e-2, le=1e7)]
_Pixel = Annotated[float, Meta(ge=-1e7, le=1e7)]
_Position = Annotated[float, Meta(ge=-1e9, le=1e9)]
_Zero = Annotated[float, Meta(ge=-1e-6, le=1e-6)]  # inverses of poses are rounded
_One = Annotated[float, Meta(ge=1 - 1e-6, le=1 + 1e-6)]
_Row = tuple[_Position, _Position, _Position, _Position]


class _Camera(msgspec.Struct):
    name: PhotoName
    size: tuple[_Side, _Side]
    viewmat: tuple[_Row, _Row, _Row, tuple[_Zero, _Zero, _Zero, _One]]
    K: tuple[tuple[_Focal, _Pixel, _Pixel], tuple[_Zero, _Focal, _Pixel], tuple[_Zero, _Zero, _One]]


class _File(msgspec.Struct):
    dtype: Literal["float32", "float64"]
    cameras: Annotated[tuple[_Camera, ...], Meta(min_length=1)]


def write_cameras(cameras: Cameras, path: Path) -> None:
    """Write cameras, unless `read_cameras` would refuse them."""
    dtype = torch.promote_types(cameras.viewmats.dtype, cameras.Ks.dtype)
    rows = [
        {
            "name": name,
            "size": cameras.sizes[row].tolist(),
            "viewmat": cameras.viewmats[row].tolist(),
            "K": cameras.Ks[row].tolist(),
        }
        for row, name in enumerate(cameras.names)
    ]
    content = {"dtype": str(dtype).removeprefix("torch."), "cameras": rows}
    fitting(content, _File, f"Cannot write {path}", "Change the cameras.")
    _refuse_faulty(cameras, f"Cannot write {path}", "Change the cameras.")
    write_json(content, path)


def read_cameras(path: Path) -> Cameras:
    content = read_json_as(path, _File, REMEDY)
    dtype = torch.float32 if content.dtype == "float32" else torch.float64
    cameras = Cameras(
        viewmats=torch.tensor([each.viewmat for each in content.cameras], dtype=dtype),
        Ks=torch.tensor([each.K for each in content.cameras], dtype=dtype),
        sizes=torch.tensor([each.size for each in content.cameras]),
        names=tuple(each.name for each in content.cameras),
    )
    _refuse_faulty(cameras, f"Cannot read {path}", REMEDY)
    return cameras


def _refuse_faulty(cameras: Cameras, what: str, remedy: str) -> None:
    fault = None
    rigid = are_rigid(cameras.viewmats, 2 * ROTATION_TOLERANCE)  # twice: they were rounded since
    if len(set(cameras.names)) < len(cameras):
        fault = "two cameras have the same name"
    elif int(cameras.sizes.prod(dim=1).max()) > MAX_PIXELS:
        fault = f"a camera has more than {MAX_PIXELS} pixels"
    elif not rigid.all():
        fault = f"the pose of {cameras.names[int(rigid.int().argmin())]} is no rotation and shift"
    if fault:
        raise StyleSplatError(f"{what}: {fault}. {remedy}")
