"""COLMAP reconstructions as poses of photos, and how good they are."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64
from scipy.spatial.transform import Rotation
from torch import Tensor

from stylesplat.errors import StyleSplatError, error_context, join_names
from stylesplat.io.captures.colmap_files import (
    CameraRecord,
    ImageRecord,
    model_files,
    read_camera_records,
    read_image_records,
    read_point_records,
)
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.photo_names import FoundPhotos, find_photos
from stylesplat.io.captures.posed_files import PosedFiles, SparsePoints, read_points
from stylesplat.io.files import is_file
from stylesplat.io.kinds import find_poses
from stylesplat.photo_libraries import pycolmap
from stylesplat.progress import SILENCE, observed, say

POINTS_PLY = "points3D.ply"
IDENTITY = (0.0, 0.0, 0.0, 1.0)  # as a quaternion of scipy


@dataclass(frozen=True)
class _Model:
    files: dict[str, Path]
    cameras: dict[int, CameraRecord]
    images: list[ImageRecord]
    photos: FoundPhotos

    @property
    def folder(self) -> Path:
        return self.files["images"].parent


def read_colmap(folder: Path, models: Sequence[Path]) -> PosedFiles:
    """Read poses, cameras and points, of the model of most photos; photos are sorted by name."""
    model = _largest(folder, models)
    found, lenses = model.photos, _lenses(model)
    if not model.images:
        raise StyleSplatError(
            f"{model.folder} has {len(model.cameras)} cameras and 0 images, none of them posed. "
            "Run the reconstruction again."
        )
    if not found.names:
        names = join_names(sorted(image.name for image in model.images))
        raise StyleSplatError(
            f"{folder} has none of the {len(model.images)} photos that {model.folder} poses: "
            f"{names}. Put them into its folder images, or give the folder that holds both."
        )
    if found.renamed:
        pairs = join_names(f"{old} is {new}" for old, new in found.renamed.items())
        say(f"Photos that are called otherwise in {model.folder}: {pairs}.")
    images = sorted(
        (image for image in model.images if image.name in found.names),
        key=lambda image: found.names[image.name],
    )
    names = tuple(found.names[image.name] for image in images)
    means, colors = _points(model)
    return PosedFiles(
        names=names,
        paths=tuple(found.folder / name for name in names),
        lenses=tuple(lenses[image.camera_id] for image in images),
        viewmats=_viewmats(images),
        points=means,
        point_colors=colors,
        missing=tuple(sorted(i.name for i in model.images if i.name not in found.names)),
    )


def _points(model: _Model) -> SparsePoints:
    """Positions and colours; of a PLY file, as INRIA's code writes, if there are no others."""
    if "points3D" in model.files:
        points = read_point_records(model.files["points3D"])
        if len(points.means):
            return torch.from_numpy(points.means), torch.from_numpy(points.colors)
    elif is_file(model.folder / POINTS_PLY):
        return read_points(model.folder / POINTS_PLY)
    say(f"{model.folder} has no points: training starts from random ones.")
    return None, None


def _largest(folder: Path, models: Sequence[Path]) -> _Model:
    read = [_read_model(folder, path) for path in models]
    best = max(read, key=lambda model: len(model.photos.names))
    if len(read) > 1:
        others = (f"{m.folder.name} ({len(m.photos.names)})" for m in read if m is not best)
        say(
            f"Of the {len(read)} models in {best.folder.parent}, {best.folder.name} is used, which "
            f"poses most photos ({len(best.photos.names)}); left out: {join_names(others)}."
        )
    return best


def _read_model(folder: Path, path: Path) -> _Model:
    """A model without its points; images without a camera, and second poses, are left out."""
    files = model_files(path)
    cameras, images = read_camera_records(files["cameras"]), read_image_records(files["images"])
    lost = [image for image in images if image.camera_id not in cameras]
    if lost:
        ids = join_names(sorted({image.camera_id for image in lost}))
        fault = f"{files['cameras']} has no camera {ids}"
        if len(lost) == len(images):
            raise StyleSplatError(f"{fault}, which all images have. Copy it again.")
        say(f"{fault}, so left out: {join_names(image.name for image in lost)}.")
    images = [image for image in images if image.camera_id in cameras]
    first = {image.name: image for image in reversed(images)}
    if len(first) < len(images):
        again = (name for name, n in Counter(i.name for i in images).items() if n > 1)
        say(f"Posed more than once in {path}, so by the first pose: {join_names(again)}.")
        images = [*reversed(first.values())]
    return _Model(files, cameras, images, find_photos(folder, sorted(first), path))


def _lenses(model: _Model) -> dict[int, Lens]:
    lenses = dict[int, Lens]()
    found = (image for image in model.images if image.name in model.photos.names)
    for id in sorted({image.camera_id for image in found}):
        camera = model.cameras[id]
        with error_context(f"Camera {id} in {model.files['cameras']}"):
            lenses[id] = Lens.create(camera.model, camera.width, camera.height, camera.params)
    return lenses


def _viewmats(images: Sequence[ImageRecord]) -> Float64[Tensor, "C 4 4"]:
    """World to camera; NaN where a quaternion is no rotation."""
    poses = np.array([image.pose for image in images]).reshape(-1, 7)
    quats = poses[:, [1, 2, 3, 0]]  # scipy has w last
    norms = np.linalg.norm(quats, axis=1, keepdims=True)
    good = (norms > 0) & np.isfinite(norms)
    viewmats = np.tile(np.eye(4), (len(poses), 1, 1))
    viewmats[:, :3, :3] = Rotation.from_quat(np.where(good, quats, IDENTITY)).as_matrix()
    viewmats[:, :3, 3] = poses[:, 4:]
    viewmats[~good[:, 0]] = np.nan
    return torch.from_numpy(viewmats)


def posed_images(model: "pycolmap.Reconstruction") -> list["pycolmap.Image"]:
    return sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name)


def viewmats_of(images: Sequence["pycolmap.Image"]) -> Float64[Tensor, "C 4 4"]:
    viewmats = torch.eye(4, dtype=torch.float64).repeat(len(images), 1, 1)
    viewmats[:, :3] = torch.from_numpy(np.stack([i.cam_from_world().matrix() for i in images]))
    return viewmats


@dataclass(frozen=True)
class ModelFigures:
    """How well the photos of a reconstruction hold together."""

    error: float | None
    """Mean reprojection error in pixels; None if unknown."""
    track_length: float
    """Mean number of photos that a point was found in."""
    shared: dict[str, int]
    """Number of points by name of the photo."""


def read_figures(folder: Path) -> ModelFigures | None:
    """Read the figures of a capture; None without a COLMAP model, or if its points lack tracks."""
    poses = find_poses(folder)
    if not poses or poses[0].form != "colmap":
        return None
    with observed(SILENCE):  # `read_colmap` says what is left out
        model = _largest(folder, poses[0].paths)
        if "points3D" not in model.files:
            return None
        points = read_point_records(model.files["points3D"], tracks=True)
    found = [image for image in model.images if image.name in model.photos.names]
    ids = np.array([image.id for image in found])
    known = np.isin(points.images, ids)
    if not known.any():
        return None
    counts = Counter(points.images[known].tolist())
    errors = points.errors[points.errors >= 0]
    return ModelFigures(
        error=float(errors.mean()) if len(errors) else None,
        track_length=int(known.sum()) / len(points.means),
        shared={model.photos.names[image.name]: counts[image.id] for image in found},
    )
