"""How photos of a capture differ in what their camera did: blur, exposure, white balance."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.progress import track
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.projection import project, shown
from stylesplat.structure_from_motion.sharpness import SIDE, relative, sharpness

MAX_POINTS = 4000  # whose colours are compared
LEAST_POINTS = 30  # that a photo must show for that
KNOWN = 0.5  # share of photos that show so many, below which whole photos are compared
DARK, BRIGHT = 12, 243  # levels within which a colour tells of exposure
GAMMA = 2.2  # of sRGB, roughly


@dataclass(frozen=True)
class PhotoLooks:
    """One number a photo."""

    sharpness: Float[Tensor, " C"]
    """Relative to the median of the neighbours: 1 is typical, less is blurred."""
    stops: Float[Tensor, " C"]
    """How much brighter it is than the median photo, in steps of exposure; NaN if unknown."""
    warmth: Float[Tensor, " C"]
    """How much redder, against blue, in the same steps."""
    by_points: bool
    """Whether colours of the same points were compared, not those of whole photos."""


def photo_looks(capture: Capture) -> PhotoLooks:
    """Look at all photos, one by one.

    Raises:
        StyleSplatError: If one is not readable.
    """
    points, colors = capture.points, capture.point_colors
    if points is None or colors is None:
        points, colors = torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.uint8)
    step = max(1, len(points) // MAX_POINTS)
    points, colors = points[::step], colors[::step]
    sharp, whole, gains = [], [], []
    for row in track(range(len(capture)), "looking at photos", unit="photo"):
        photo = _small(capture.photos[row])
        sharp.append(sharpness(cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)))
        whole.append(_mean_color(photo))
        gains.append(_gain(photo, capture.cameras[row], points, colors))
    stops = torch.stack(gains)  # [C, 3]
    by_points = bool(stops.isfinite().all(dim=1).float().mean() > KNOWN)
    stops = stops if by_points else torch.stack(whole)
    stops = stops - stops.nanmedian(dim=0).values
    warmth = stops[:, 0] - stops[:, 2]
    return PhotoLooks(torch.tensor(relative(sharp)), stops.mean(dim=1), warmth, by_points)


def _small(photo: UInt8[Tensor, "H W 3"]) -> UInt8[np.ndarray, "h w 3"]:
    height, width = photo.shape[:2]
    factor = min(1.0, SIDE / max(width, height))
    size = (max(1, round(factor * width)), max(1, round(factor * height)))
    return cv2.resize(photo.cpu().numpy(), size, interpolation=cv2.INTER_AREA)


def _mean_color(photo: UInt8[np.ndarray, "h w 3"]) -> Float[Tensor, "3"]:
    colors = torch.from_numpy(photo).float().flatten(0, 1).mean(dim=0)
    return GAMMA * (colors.clamp(min=1) / 255).log2()


def _gain(
    photo: UInt8[np.ndarray, "h w 3"],
    camera: Cameras,
    points: Float[Tensor, "M 3"],
    colors: UInt8[Tensor, "M 3"],
) -> Float[Tensor, "3"]:
    """How much brighter a photo shows points than they are on average; the median bears that
    other things hide some of them."""
    rows = shown(points, camera).nonzero()[:, 0]
    places, _ = project(points[rows], camera)
    height, width = photo.shape[:2]
    places = places * torch.tensor([width, height]) / torch.tensor(camera.size)
    x, y = places.long().unbind(dim=1)
    here = torch.from_numpy(photo)[y.clamp(max=height - 1), x.clamp(max=width - 1)].float()
    usual = colors[rows].float()
    told = ((here > DARK) & (here < BRIGHT) & (usual > DARK) & (usual < BRIGHT)).all(dim=1)
    if told.sum() < LEAST_POINTS:
        return torch.full((3,), torch.nan)
    return GAMMA * (here[told] / usual[told]).log2().median(dim=0).values
