"""All cameras of a scene as JSON, and camera paths: nerfstudio's, and key frames of our own."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import torch
from msgspec import Meta
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.json_yaml import (
    MAX_JSON,
    PhotoName,
    convert_checked,
    read_json,
    read_json_as,
    write_json,
)
from stylesplat.options import check_arguments
from stylesplat.scene.cameras import (
    ROTATION_TOLERANCE,
    Cameras,
    are_rigid,
    look_at,
    median_lens,
    up_vector,
)
from stylesplat.scene.virtual_cameras import MOST_FRAMES, frame_count, path_of, smooth_path
from stylesplat.scene.world_offset import ORIGIN, Offset, from_world

PATH_MAX_PIXELS = 2**28  # of a view: larger renders do not fit into memory
TRAIN_AGAIN = "Train again."

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
    convert_checked(content, _File, f"Cannot write {path}", "Change the cameras.")
    _refuse_faulty(cameras, f"Cannot write {path}", "Change the cameras.")
    write_json(content, path)


def read_cameras(path: Path) -> Cameras:
    content = read_json_as(path, _File, TRAIN_AGAIN)
    dtype = torch.float32 if content.dtype == "float32" else torch.float64
    cameras = Cameras(
        viewmats=torch.tensor([each.viewmat for each in content.cameras], dtype=dtype),
        Ks=torch.tensor([each.K for each in content.cameras], dtype=dtype),
        sizes=torch.tensor([each.size for each in content.cameras]),
        names=tuple(each.name for each in content.cameras),
    )
    _refuse_faulty(cameras, f"Cannot read {path}", TRAIN_AGAIN)
    return cameras


def _refuse_faulty(cameras: Cameras, what: str, remedy: str) -> None:
    fault = None
    rigid = are_rigid(cameras.viewmats, 2 * ROTATION_TOLERANCE)  # twice: they were rounded since
    if len(set(cameras.names)) < len(cameras):
        fault = "two cameras have the same name"
    elif int(cameras.sizes.prod(dim=1).max()) > PATH_MAX_PIXELS:
        fault = f"a camera has more than {PATH_MAX_PIXELS} pixels"
    elif not rigid.all():
        fault = f"the pose of {cameras.names[int(rigid.int().argmin())]} is no rotation and shift"
    if fault:
        raise StyleSplatError(f"{what}: {fault}. {remedy}")


PATH_FPS, SECONDS = 30.0, 6.0  # unless a file says otherwise
READ_MANUAL = "The manual's section on `render` says what a path is."

FrameSide = Annotated[float, Meta(ge=2, le=16384)]  # some programs write 1080.0
Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
Degrees = Annotated[float, Meta(gt=0.1, lt=179)]
Rate = Annotated[float, Meta(gt=0, le=1000)]
Vector = tuple[Number, Number, Number]
Matrix = Annotated[list[Number], Meta(min_length=16, max_length=16)]


class _Pose(msgspec.Struct):
    camera_to_world: Matrix
    """Row by row, in OpenGL's axes: y up, z back."""
    fov: Degrees
    """Vertical."""


class _Nerfstudio(msgspec.Struct):
    """What nerfstudio's viewer writes, and `ns-render camera-path` reads."""

    camera_path: Annotated[list[_Pose], Meta(min_length=1, max_length=MOST_FRAMES)]
    render_width: FrameSide
    render_height: FrameSide
    camera_type: Literal["perspective"] = "perspective"
    fps: Rate = PATH_FPS


class _Key(msgspec.Struct, forbid_unknown_fields=True):
    """The camera of a photo, or a position and a point to look at."""

    view: str | None = None
    position: Vector | None = None
    look_at: Vector | None = None
    fov: Degrees | None = None
    """Vertical; by default that of the photo, or of the median photo."""


class _Keys(msgspec.Struct, forbid_unknown_fields=True):
    keyframes: Annotated[list[_Key], Meta(min_length=2, max_length=10_000)]
    seconds: Annotated[float, Meta(gt=0, le=MOST_FRAMES)] = SECONDS
    fps: Rate = PATH_FPS
    closed: bool = False


@dataclass(frozen=True, eq=False)
class CameraPath:
    cameras: Cameras
    fps: float


@check_arguments
def read_camera_path(
    path: Path | str,
    views: Cameras,
    *,
    fps: float | int | None = None,
    seconds: float | int | None = None,
    world_offset: Offset = ORIGIN,
) -> CameraPath:
    """Read a camera path: nerfstudio's (a file with `camera_path`), or key frames.

    Args:
        path: A JSON file. Positions are in the world of the scene.
        views: The scene's cameras: key frames name them, and they give the up direction and lens.
        fps: Frames a second instead of the file's.
        seconds: Duration of the way through key frames instead of the file's.
        world_offset: That of the scene: the cameras will be relative to it, as its own are.

    Raises:
        StyleSplatError: If the file is missing or holds anything else, or a duration was given
            for a path of nerfstudio's, which has its frames.
    """
    content, what = read_json(path, most=MAX_JSON), f"Cannot read {path}"
    if "camera_path" in content:
        if seconds is not None:
            raise StyleSplatError(
                f"{path} holds every frame, so its duration is fixed. Choose the frames a second "
                "with --fps."
            )
        found: _Nerfstudio = convert_checked(content, _Nerfstudio, what, READ_MANUAL)
        return CameraPath(_nerfstudio(found, world_offset, what), float(fps or found.fps))
    keys: _Keys = convert_checked(content, _Keys, what, READ_MANUAL)
    count = frame_count(seconds or keys.seconds, fps or keys.fps)
    _, size = median_lens(views)
    poses = _key_frames(keys, views, world_offset, what)
    frames = smooth_path(*poses, count, size, closed=keys.closed)
    return CameraPath(frames, float(fps or keys.fps))


def _nerfstudio(found: _Nerfstudio, offset: Offset, what: str) -> Cameras:
    numbers = [pose.camera_to_world for pose in found.camera_path]
    poses = torch.tensor(numbers, dtype=torch.float64).reshape(-1, 4, 4)
    poses[:, :3, 3] = from_world(poses[:, :3, 3], offset)
    poses[:, :3, 1:3] *= -1  # y down, z ahead
    wrong = (~are_rigid(poses)).nonzero()[:, 0].tolist()
    if wrong or not torch.equal(poses[:, 3], torch.eye(4).double()[3].expand(len(poses), 4)):
        which = f"frame {wrong[0]}" if wrong else "a last row"
        raise StyleSplatError(
            f"{what}: {which} of its camera_to_world is no turn and shift. {READ_MANUAL}"
        )
    focals = torch.tensor([_focal(pose.fov) for pose in found.camera_path])
    size = (round(found.render_width), round(found.render_height))
    return path_of(torch.linalg.inv(poses), focals, size)


def _key_frames(keys: _Keys, views: Cameras, offset: Offset, what: str) -> tuple[Tensor, Tensor]:
    """World-to-camera matrices, and focal lengths over the pictures' height."""
    lens, (_, height) = median_lens(views)
    up, viewmats, focals = up_vector(views), list[Tensor](), list[float]()
    for row, key in enumerate(keys.keyframes):
        focal = float(lens[1, 1]) / height
        if key.view is not None and key.position is None and key.look_at is None:
            index = views.index(key.view)
            viewmats.append(views.viewmats[index].double().cpu())
            focal = float(views.Ks[index, 1, 1]) / float(views.sizes[index, 1])
        elif key.view is None and key.position is not None and key.look_at is not None:
            places = torch.tensor([key.position, key.look_at], dtype=torch.float64)
            eye, focus = from_world(places, offset)
            viewmats.append(look_at(eye[None], focus, up)[0])
            if not are_rigid(viewmats[-1][None]).all():
                raise StyleSplatError(
                    f"{what}: key frame {row} looks nowhere, or straight up or down. Move it a "
                    "little."
                )
        else:
            raise StyleSplatError(
                f"{what}: key frame {row} needs a view, or a position and look_at. {READ_MANUAL}"
            )
        focals.append(focal if key.fov is None else _focal(key.fov))
    return torch.stack(viewmats), torch.tensor(focals)


def _focal(fov: float) -> float:
    return 0.5 / math.tan(math.radians(fov) / 2)
