"""The still life: where its objects stand, cameras around it, photos, points on its surfaces."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from stylesplat.scene.cameras import Cameras, look_at
from stylesplat.scene.projection import pixel_centres, unproject

from .objects import NAMES
from .tracer import render_view

OBJECT_NAMES = {i + 1: name for i, name in enumerate(NAMES)}

TARGET = (-0.03, 0.0, 0.38)  # where every camera looks
DISTANCE = 3.6
ELEVATIONS = (19.0, 46.0)  # degrees: one ring sees the sides, the other the tops
SWAY = 4.0  # degrees by which a ring rises and falls, as a hand does
FOCAL = 1.12  # of the image's width
SPOTS = ((-0.06, 0.24), (0.50, -0.42), (-0.38, -0.60), (-0.87, 0.03), (0.66, 0.56))
YAWS = (0.0, -0.35, 0.6, 0.45, 0.3)  # radians
PLAY = (3.0, 0.06, 3.0, 0.3, 3.0)  # radians that an object can turn without touching another


@dataclass(frozen=True)
class View:
    """What one camera sees, exact at the pixel centres."""

    photo: UInt8[Tensor, "H W 3"]
    """sRGB, with 2x2 supersampling."""
    labels: Int[Tensor, "H W"]
    """Ids of `OBJECT_NAMES`; 0 is the table and the backdrop."""
    depth: Float[Tensor, "H W"]
    """Along the camera's z axis."""


def arrange(seed: int) -> Float[np.ndarray, "5 5"]:
    """Place the objects: x, y, cosine and sine of the turn, shift of the grain.

    Seed 0 is the arrangement the composition was made for; the others push and turn the
    objects and give them other grain.
    """
    rng = np.random.default_rng(seed)
    loose = float(seed != 0)
    spots = np.array(SPOTS) + loose * rng.uniform(-0.02, 0.02, (len(SPOTS), 2))
    yaws = np.array(YAWS) + loose * rng.uniform(-1, 1, len(YAWS)) * PLAY
    grain = rng.uniform(0, 50, len(SPOTS))
    return np.column_stack([spots, np.cos(yaws), np.sin(yaws), grain])


def dome_cameras(views: int, width: int, height: int) -> Cameras:
    """Cameras on two swaying rings around the still life, lower ring first."""
    target = torch.tensor(TARGET)
    positions = []
    for i in range(views):
        ring = int(2 * i >= views)
        angle = torch.tensor(2 * np.pi * (2 * i + ring) / views)
        tilt = torch.deg2rad(ELEVATIONS[ring] + SWAY * torch.sin(3 * angle))
        level = torch.cos(tilt)
        outward = torch.stack([level * angle.cos(), level * angle.sin(), tilt.sin()])
        positions.append(target + DISTANCE * outward.float())
    focal = FOCAL * width
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Cameras(
        viewmats=look_at(torch.stack(positions), target, torch.tensor([0.0, 0.0, 1.0])),
        Ks=K.expand(views, 3, 3).clone(),
        sizes=torch.tensor([[width, height]]).expand(views, 2).clone(),
        names=tuple(f"{i:03d}.jpg" for i in range(views)),
    )


def photograph(cameras: Cameras, layout: Float[np.ndarray, "5 5"]) -> Iterator[View]:
    """Render objects, as `arrange` has placed them, from each camera, lazily."""
    for viewmat, K, (width, height) in zip(
        cameras.viewmats.double(), cameras.Ks.double(), cameras.sizes.tolist(), strict=True
    ):
        photo = np.empty((height, width, 3), np.float32)
        geometry = np.empty((height, width, 2), np.float32)
        render_view(K.numpy(), viewmat.inverse().numpy(), layout, photo, geometry)
        yield View(
            photo=torch.from_numpy((photo * 255).round().astype(np.uint8)),
            labels=torch.from_numpy(geometry[..., 0].astype(np.int64)),
            depth=torch.from_numpy(geometry[..., 1].copy()),
        )


POINT_NOISE = 1.5e-3  # standard deviation of a point, as a fraction of its depth
PLAIN = 0.15  # how likely a point is where the photo is plain, relative to its mean contrast


def surface_points(
    cameras: Cameras, views: Sequence[View], count: int, *, seed: int = 0
) -> tuple[Float[Tensor, "M 3"], UInt8[Tensor, "M 3"]]:
    """Sample visible surface points with a little noise, more of them where photos have detail.

    Args:
        cameras: One per view.
        views: What the cameras see.
        count: How many points to take, in equal parts from all views.
        seed: Of the choice of pixels and the noise.

    Returns:
        The points and their sRGB colours.
    """
    rng = np.random.default_rng(seed)
    positions, colors = [], []
    for i, view in enumerate(views):
        share = count * (i + 1) // len(views) - count * i // len(views)
        pixels = torch.from_numpy(_detailed_pixels(view.photo.numpy(), share, rng))
        noise = torch.from_numpy(rng.normal(0, POINT_NOISE, (share, 3)).astype(np.float32))
        depths = view.depth.flatten()[pixels]
        places = pixel_centres(*cameras[i].size)[pixels]
        positions.append(unproject(places, depths, cameras[i]) + noise * depths[:, None])
        colors.append(view.photo.reshape(-1, 3)[pixels])
    return torch.cat(positions), torch.cat(colors)


def _detailed_pixels(
    photo: UInt8[np.ndarray, "H W 3"], count: int, rng: np.random.Generator
) -> np.ndarray:
    """Flat indices of pixels, drawn in proportion to local contrast."""
    grey = photo.mean(axis=-1, dtype=np.float32)
    contrast = np.abs(grey - cv2.GaussianBlur(grey, (0, 0), 2))
    chance = (contrast + PLAIN * contrast.mean() + 1e-6).ravel().astype(np.float64)
    return rng.choice(chance.size, count, replace=count > chance.size, p=chance / chance.sum())
