"""`transforms.json` of instant-ngp and nerfstudio, and NeRF-synthetic's files, one per split."""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError, join_names, shorten
from stylesplat.io.captures.lens import LENS_MAX_SIDE, Lens
from stylesplat.io.captures.photo_names import find_files
from stylesplat.io.captures.posed_files import PosedFiles, SparsePoints, check_path, read_points
from stylesplat.io.files import is_file, reason
from stylesplat.io.images import image_sizes
from stylesplat.io.json_yaml import convert_checked, read_json
from stylesplat.io.kinds import SPLIT_TRANSFORMS, SPLITS, TRANSFORMS
from stylesplat.progress import say

TRANSFORMS_EXTENSIONS = (".png", ".jpg", ".jpeg", ".webp")  # tried where a name has none
TRANSFORMS_POINTS = "points3d.ply"  # of INRIA's code and BlenderNeRF, beside split files
FISHEYE = "OPENCV_FISHEYE"
FRAME_MODELS = ("OPENCV", "FULL_OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
LENS_KEYS = ("latlong", "equirectangular", "orthographic", "ftheta_p0")  # instant-ngp's others
TRANSFORMS_AGAIN = "Pose the photos again."
# Camera axes in x right, y down, z ahead. OpenGL's are x right, y up, z back; keys of instant-ngp
# and NeuS2 declare Mitsuba's (x left, y up, z ahead) and OpenCV's
OPENGL_AXES, MITSUBA_AXES, OPENCV_AXES = (
    torch.tensor(signs, dtype=torch.float64)
    for signs in ((1.0, -1.0, -1.0, 1.0), (-1.0, -1.0, 1.0, 1.0), (1.0, 1.0, 1.0, 1.0))
)
MITSUBA_KEYS = ("normal_mts_args", "from_mitsuba")
OPENCV_KEY = "from_na"
# Keys that change neither photos nor cameras: frames and bounds of other programs' viewers and
# networks, transforms that are in the poses already, and notes
NEUTRAL = {
    *("aabb", "aabb_scale", "aabb_range", "render_aabb", "scale", "offset", "up"),
    *("applied_transform", "applied_scale", "orientation_override", "near", "far"),
    *("rotation", "sharpness", "colmap_im_id", "n_frames", "n_extra_learnable_dims"),
    *("enable_depth_loading", "enable_ray_loading", "envmap_resolution"),
}

PoseNumber = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
CameraSide = Annotated[float, msgspec.Meta(ge=1, le=LENS_MAX_SIDE)]  # some programs write 1920.0
MatrixRow = Annotated[list[float], msgspec.Meta(min_length=4, max_length=4)]  # which may be NaN
Pose = Annotated[list[MatrixRow], msgspec.Meta(min_length=3, max_length=4)]


class _Frame(msgspec.Struct):
    """The entry of a photo, merged with the entries that apply to all."""

    file_path: str
    transform_matrix: Pose
    w: CameraSide | None = None
    h: CameraSide | None = None
    fl_x: PoseNumber | None = None
    fl_y: PoseNumber | None = None
    camera_angle_x: PoseNumber | None = None
    camera_angle_y: PoseNumber | None = None
    cx: PoseNumber | None = None
    cy: PoseNumber | None = None
    k1: PoseNumber = 0.0
    k2: PoseNumber = 0.0
    k3: PoseNumber = 0.0
    k4: PoseNumber = 0.0
    p1: PoseNumber = 0.0
    p2: PoseNumber = 0.0
    camera_model: str | None = None
    is_fisheye: bool = False
    mask_path: str | None = None


class _Transforms(msgspec.Struct):
    """The file, without the keys that a frame may have too."""

    frames: list[dict[str, Any]] = []
    ply_file_path: str | None = None
    train_filenames: list[str] = []
    val_filenames: list[str] = []
    test_filenames: list[str] = []


class _Posed(NamedTuple):
    """A frame, and its photo and mask."""

    photo: Path
    place: Path
    """The photo's path, absolute and without dots, by which it is known."""
    frame: _Frame
    axes: Float[Tensor, "4"]
    mask: Path | None
    file: Path


class _Split(NamedTuple):
    """Photos that a file lists for one purpose."""

    listed: set[Path]
    source: str
    """What lists them, in messages."""


def read_transforms(folder: Path) -> PosedFiles:
    """Read poses and cameras, the points where a file has some, and which photos are held out.

    Without `transforms.json` the frames are those of `transforms_train.json` and the like.
    Intrinsics may be given in each frame or once for all. Photos may lie anywhere; they are sorted
    by path, and named relative to their common folder.
    """
    posed, splits, points = list[_Posed](), dict[str, _Split](), None
    if is_file(folder / TRANSFORMS):
        files = [folder / TRANSFORMS]
    else:
        files = [folder / name for name in SPLIT_TRANSFORMS if is_file(folder / name)]
    for path in files:
        frames, listed, named_points = _read_file(path)
        posed += frames
        splits |= listed
        points = points or named_points
    if not posed:
        raise StyleSplatError(f"{files[0]} has no frames, so no cameras. Pose the photos again.")
    posed, held_out = _hold_out([*_without_repeats(posed)], splits)
    posed.sort(key=lambda each: each.place)
    common = Path(os.path.commonpath([each.place.parent for each in posed]))
    names = tuple(each.place.relative_to(common).as_posix() for each in posed)
    pairs = [*zip(names, posed, strict=True)]
    reserved = None if held_out is None else {n for n, each in pairs if each.place in held_out}
    viewmats = [_viewmat(each) for each in posed]
    masks = tuple(each.mask for each in posed)
    means, colors = _read_points(folder, points)
    return PosedFiles(
        names=names,
        paths=tuple(each.photo for each in posed),
        lenses=tuple(_read_lens(each) for each in posed),
        viewmats=torch.stack(viewmats),
        points=means,
        point_colors=colors,
        masks=masks if any(masks) else None,
        held_out=None if reserved is None else frozenset(reserved),
    )


def _read_file(path: Path) -> tuple[list[_Posed], dict[str, _Split], str | None]:
    """The frames of a file, the photos by what they are for, and the name of the points."""
    folder, content = path.parent, read_json(path)
    whole = convert_checked(content, _Transforms, f"{path} is malformed", TRANSFORMS_AGAIN)
    merged = [content | frame for frame in whole.frames]
    fault = f"A frame of {path} is malformed"
    frames = [  # nerfstudio writes RealityCapture's distortion as text
        convert_checked(each, _Frame, fault, TRANSFORMS_AGAIN, strict=False) for each in merged
    ]
    for frame in frames:
        check_path(frame.file_path)
        check_path(frame.mask_path or "")
    _say_unused(path, content, merged)
    names = [frame.file_path for frame in frames]
    photos = find_files(folder, names, f"photos of {path.name}", suffixes=TRANSFORMS_EXTENSIONS)
    masks = [frame.mask_path for frame in frames if frame.mask_path]
    found = dict(zip(masks, find_files(folder, masks, f"masks of {path.name}"), strict=True))
    posed = [
        _Posed(photo, _place(photo), frame, _axes(each), found.get(frame.mask_path or ""), path)
        for photo, frame, each in zip(photos, frames, merged, strict=True)
    ]
    splits = dict[str, _Split]()
    for split, file in zip(SPLITS, SPLIT_TRANSFORMS, strict=True):
        names = getattr(whole, f"{split}_filenames")
        listed = find_files(folder, names, f"{split}_filenames", suffixes=TRANSFORMS_EXTENSIONS)
        if path.name == file:
            splits[split] = _Split({*map(_place, photos)}, file)
        elif names:
            splits[split] = _Split({*map(_place, listed)}, f"{split}_filenames of {path.name}")
    return posed, splits, whole.ply_file_path


def _say_unused(
    path: Path, content: Mapping[str, Any], frames: Sequence[Mapping[str, Any]]
) -> None:
    """Say which keys are not used, and refuse those of lenses that no photo of a scene has."""
    keys = dict.fromkeys(key for each in (content, *frames) for key in each)
    lens = next((k for k in LENS_KEYS if any(each.get(k) for each in (content, *frames))), None)
    if lens is not None:
        raise StyleSplatError(
            f"{path} has {lens} cameras, which cannot be undistorted. Use photos of a lens."
        )
    used = {field for kind in (_Frame, _Transforms) for field in kind.__struct_fields__}
    known = {*used, *NEUTRAL, *MITSUBA_KEYS, OPENCV_KEY, *LENS_KEYS}
    others = [key for key in keys if key not in known]
    if others:
        say(f"{path.name} has keys that are not used: {join_names(others, most=len(others))}.")


def _axes(content: Mapping[str, Any]) -> Float[Tensor, "4"]:
    if any(content.get(key) for key in MITSUBA_KEYS):
        return MITSUBA_AXES
    return OPENCV_AXES if content.get(OPENCV_KEY) else OPENGL_AXES


def _without_repeats(posed: Sequence[_Posed]) -> Iterator[_Posed]:
    """The frames without those that another file has with the same pose."""
    first = dict[Path, _Posed]()
    for each in posed:
        before = first.setdefault(each.place, each)
        same = before.frame.transform_matrix == each.frame.transform_matrix
        if before is each or before.file == each.file or not same:
            yield each


def _hold_out(
    posed: list[_Posed], splits: Mapping[str, _Split]
) -> tuple[list[_Posed], set[Path] | None]:
    """The frames to use, and the photos of them that are held out if the files say so.

    The test split is held out, or without one that for validation. Photos to train on count as
    that whatever else lists them; photos that are neither are left out, with a line.
    """
    if not splits:
        return posed, None
    photos, nothing = {each.place for each in posed}, _Split(set(), "")
    train, test, val = (splits.get(split, nothing) for split in SPLITS)
    to_train = train.listed & photos or photos - test.listed - val.listed
    unlisted = _Split(photos - to_train, "no list")
    choices = [each for each in (test, val, unlisted) if (each.listed & photos) - to_train]
    again = (test.listed | val.listed) & train.listed
    if again:
        say(f"{len(again)} photos of {test.source or val.source} are of {train.source} too.")
    if not to_train or not choices:
        return posed, None
    held_out = (choices[0].listed & photos) - to_train
    say(
        f"The {len(held_out)} photos of {choices[0].source} are held out. `--test-every 0` trains "
        f"on them, too."
    )
    others = photos - to_train - held_out
    if others:
        of = f" of {val.source}" if others <= val.listed else ""
        say(f"{len(others)} photos{of} are neither trained on nor held out.")
    return [each for each in posed if each.place not in others], held_out


def _place(path: Path) -> Path:
    return Path(os.path.normpath(path.absolute()))


def _viewmat(posed: _Posed) -> Float[Tensor, "4 4"]:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3] = torch.tensor(posed.frame.transform_matrix[:3], dtype=torch.float64)
    # No error for a singular matrix: `load` names all bad poses at once
    return torch.linalg.inv_ex(pose * posed.axes).inverse


def _read_lens(posed: _Posed) -> Lens | None:
    """The lens of a frame; None if that depends on a photo that is not there."""
    frame, photo, path = posed.frame, posed.photo, posed.file
    if frame.w is None and not os.path.lexists(photo):
        return None
    named = frame.camera_model or (FISHEYE if frame.is_fisheye else "OPENCV")
    if named not in (FISHEYE, *FRAME_MODELS):
        raise StyleSplatError(
            f"{path} has cameras of the model {shorten(named)}, which is unknown. Use one of "
            f"{', '.join((*FRAME_MODELS, FISHEYE))}."
        )
    try:
        return _lens(frame, photo, named)
    except (ValueError, RuntimeError, ArithmeticError) as error:
        raise StyleSplatError(
            f"{path} is malformed: {reason(error)}. {TRANSFORMS_AGAIN}"
        ) from error


def _lens(frame: _Frame, photo: Path, model: str) -> Lens:
    if frame.w is None:
        width, height = image_sizes(photo)[0]
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
    if model == FISHEYE:
        params = [*pinhole, *k]
    elif frame.is_fisheye:
        raise ValueError(f"it has is_fisheye, but the camera model {model}")
    elif frame.k4 != 0:
        raise ValueError(f"the camera model {model} has no k4, but it is {frame.k4}")
    else:
        further = [frame.p1, frame.p2, frame.k3, 0.0, 0.0, 0.0]
        model, params = "FULL_OPENCV", [*pinhole, frame.k1, frame.k2, *further]
    return Lens.create(model, width, height, params)


def _focal(focal: float | None, angle: float | None, side: int, axis: str) -> float:
    if focal is not None:
        return focal
    if angle is None:
        raise ValueError(f"it lacks the key 'fl_{axis}'")
    if not 0 < angle < math.pi:
        raise ValueError(f"camera_angle_{axis} cannot be {angle}")
    return side / (2 * math.tan(angle / 2))


def _read_points(folder: Path, name: str | None) -> SparsePoints:
    if name is not None:
        return read_points(find_files(folder, [name], "ply_file_paths")[0])
    if is_file(folder / TRANSFORMS_POINTS):
        say(f"The points are those of {TRANSFORMS_POINTS}.")
        return read_points(folder / TRANSFORMS_POINTS)
    return None, None
