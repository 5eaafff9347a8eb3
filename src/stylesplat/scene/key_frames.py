"""Camera paths through a few key frames."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.framing import centred_K

MOST_FRAMES = 36_000  # twenty minutes at 30 a second


@dataclass(frozen=True)
class KeyFrames:
    """Two cameras or more that a path passes, one after the other, in equal times."""

    viewmats: Float[Tensor, "F 4 4"]
    """World to camera, in OpenCV axes."""
    focals: Float[Tensor, " F"]
    """Over the pictures' height."""

    def path(self, count: int, size: tuple[int, int], *, closed: bool = False) -> Cameras:
        """A smooth path: cubic splines of places, of turns, and of the logarithm of lenses.

        Args:
            count: Number of frames; the last one is the last key frame, or, on a closed path, the
                one before the first.
            size: Width and height of the pictures.
            closed: Whether it returns to the first key frame.
        """
        keys = len(self.focals)
        # A closed path is the middle one of three rounds, so that it is smooth where it closes
        rows = np.tile(np.arange(keys), 3 if closed else 1)
        begin, end = (keys, 2 * keys) if closed else (0, keys - 1)
        times, keyed = np.linspace(begin, end, count, endpoint=not closed), np.arange(len(rows))
        rotations = self.viewmats[:, :3, :3].double().numpy()
        turns = RotationSpline(keyed, Rotation.from_matrix(rotations[rows]))(times).as_matrix()
        places = -np.einsum("cji,cj->ci", rotations, self.viewmats[:, :3, 3].double().numpy())
        places = CubicSpline(keyed, places[rows], bc_type="natural")(times)
        lenses = np.log(self.focals.double().numpy())
        lenses = np.exp(CubicSpline(keyed, lenses[rows], bc_type="natural")(times))
        viewmats = torch.eye(4).repeat(count, 1, 1)
        viewmats[:, :3, :3] = torch.from_numpy(turns)
        viewmats[:, :3, 3] = -torch.from_numpy(np.einsum("cij,cj->ci", turns, places))
        return path_of(viewmats, torch.from_numpy(lenses).float(), size)


def path_of(
    viewmats: Float[Tensor, "M 4 4"], focals: Float[Tensor, " M"], size: tuple[int, int]
) -> Cameras:
    """The frames of a path.

    Args:
        viewmats: World to camera, in OpenCV axes.
        focals: Over the pictures' height.
        size: Width and height of the pictures.
    """
    width, height = size
    return Cameras(
        viewmats=viewmats.float(),
        Ks=torch.stack([centred_K(focal * height, size) for focal in focals.tolist()]),
        sizes=torch.tensor([width, height]).repeat(len(viewmats), 1),
        names=tuple(f"path_{row:05d}.png" for row in range(len(viewmats))),
    )


def frame_count(seconds: float | int, fps: float | int) -> int:
    """How many frames a video has.

    Raises:
        StyleSplatError: If that is none or far too many.
    """
    count = round(seconds * fps) if 0 < seconds * fps < float("inf") else 0
    if not 0 < count <= MOST_FRAMES:
        raise StyleSplatError(
            f"Cannot render {seconds:g} seconds at {fps:g} frames a second. Choose between 1 and "
            f"{MOST_FRAMES:,} frames in all."
        )
    return count
