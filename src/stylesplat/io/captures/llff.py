"""`poses_bounds.npy`, the captures of LLFF."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.photo_names import photo_places
from stylesplat.io.captures.posed_files import PosedFiles
from stylesplat.io.files import reading
from stylesplat.io.kinds import PHOTOS, POSES_BOUNDS

# Numbers: 3 rows of [rotation | position | height, width, focal length], and two depths
LLFF_ROW = 17
LLFF_AGAIN = "Pose the photos again."


def read_llff(folder: Path) -> PosedFiles:
    """Read poses and cameras; the photos of a folder, sorted by name, belong to the rows.

    Sizes and focal lengths are those of the photos in `images`; reduced ones have their shape.
    """
    path = folder / POSES_BOUNDS
    with reading(path, LLFF_AGAIN):
        rows = np.load(path, allow_pickle=False)
    if rows.ndim != 2 or rows.shape[1] != LLFF_ROW or not len(rows):
        raise StyleSplatError(
            f"{path} has numbers of the shape {rows.shape}, not [photos, {LLFF_ROW}] as LLFF "
            f"writes. {LLFF_AGAIN}"
        )
    photos = _photos(folder, len(rows))
    matrices = torch.from_numpy(rows[:, :15].astype(np.float64)).view(-1, 3, 5)
    return PosedFiles(
        names=tuple(photo.name for photo in photos),
        paths=tuple(photos),
        lenses=tuple(_lens(*hwf) for hwf in matrices[:, :, 4].tolist()),
        viewmats=_viewmats(matrices[:, :, :4]),
        points=None,
        point_colors=None,
    )


def _photos(folder: Path, count: int) -> list[Path]:
    """As many photos as there are poses: the full-size ones, or the least reduced."""
    found = dict[str, int]()
    for place in photo_places(folder):
        entries = (path for path in sorted(place.iterdir()) if not path.name.startswith("."))
        photos = [path for path in entries if path.suffix.lower() in PHOTOS]
        if len(photos) == count:
            return photos
        found[place.name] = len(photos)
    there = ", ".join(f"{name}/ has {number} photos" for name, number in found.items())
    raise StyleSplatError(
        f"{folder / POSES_BOUNDS} has {count} poses, but {there or 'there is no images/'}. Its "
        "rows belong to the photos in the order of their names: put back the photos that it is of."
    )


def _lens(height: float, width: float, focal: float) -> Lens:
    if not all(map(np.isfinite, (height, width, focal))) or min(height, width) < 1:
        raise StyleSplatError(f"A camera of {POSES_BOUNDS} has impossible numbers. {LLFF_AGAIN}")
    width, height = round(width), round(height)
    return Lens.create("PINHOLE", width, height, [focal, focal, width / 2, height / 2])


def _viewmats(poses: Float[Tensor, "C 3 4"]) -> Float[Tensor, "C 4 4"]:
    """World to camera, of poses whose columns are down, right, back and the position."""
    down, right, back, position = poses.unbind(dim=2)
    cameras = torch.eye(4, dtype=poses.dtype).repeat(len(poses), 1, 1)
    cameras[:, :3] = torch.stack([right, down, -back, position], dim=2)
    return torch.linalg.inv_ex(cameras).inverse
