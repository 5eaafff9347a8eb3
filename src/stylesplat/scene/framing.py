"""Where a camera stands, and how long its lens is, so that something fills its picture."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.content import Content
from stylesplat.scene.poses import look_at

FILLED = 0.92  # of the picture's width or height; the rest is room around
CLEAR = 0.5  # of the content's radius, between its nearest point and the camera
NEAREST = 0.1  # world units from the camera; nothing nearer than 0.01 is drawn
WIDEST = 0.5  # focal length over the picture's width: 90 degrees
HIDDEN = 0.1  # share of its middle that something else may hide
MIDDLE = 0.6  # of its radius, which its middle reaches to
BEFORE = 0.95  # of the way to what would hide it, where the camera stands
TINY = 1e-9


@dataclass(frozen=True)
class Sight:
    """Which way a camera looks at what, into a picture of what size."""

    focus: Float[Tensor, "3"]
    """What is in the middle."""
    outward: Float[Tensor, "3"]
    """The direction from there to the camera, of length 1."""
    up: Float[Tensor, "3"]
    """The direction that is up."""
    size: tuple[int, int]
    """Width and height in pixels."""

    def offsets(self, points: Float[Tensor, "M 3"]) -> Float[Tensor, "M 3"]:
        """Points along the camera's axes, from what it looks at."""
        return (points - self.focus) @ self.viewmats(1.0)[0, :3, :3].T

    def viewmats(self, distance: float) -> Float[Tensor, "1 4 4"]:
        """World to camera, so far away."""
        eye = self.focus + distance * self.outward
        return look_at(eye[None], self.focus, self.up)

    @property
    def half(self) -> Float[Tensor, "2"]:
        """Pixels from the middle that may be filled, across and down."""
        return FILLED * torch.tensor(self.size).double() / 2


@dataclass(frozen=True)
class Distances:
    """How far from what it looks at a camera may stand to have all content in its picture."""

    wanted: float
    """From where the content fills the picture."""
    closest: float
    """From where it does with the widest lens."""
    free: float
    """Nearer than anything that would hide the content."""

    @property
    def best(self) -> float:
        """As wanted, or nearer where something is in the way, but never too near."""
        return max(min(self.wanted, max(self.free, self.closest)), NEAREST)


def distances(content: Content, sight: Sight, focal: float) -> Distances:
    """How far away a camera may stand.

    Args:
        content: What to show.
        sight: From where.
        focal: Wanted, in pixels.
    """
    offsets = sight.offsets(content.outline)
    radius = max(float(offsets.norm(dim=1).max()), TINY)
    return Distances(
        wanted=_distance(offsets, radius, sight.half / focal),
        closest=_distance(offsets, radius, sight.half / (WIDEST * sight.size[0])),
        free=BEFORE * _free(content, sight, radius),
    )


def focal_at(points: Float[Tensor, "M 3"], sight: Sight, distance: float) -> float:
    """The focal length in pixels with which points fill the picture.

    Args:
        points: What to show.
        sight: From where.
        distance: Of the camera from what it looks at.
    """
    offsets = sight.offsets(points)
    lateral = offsets[:, :2].abs().clamp(min=TINY * distance)
    depths = (distance + offsets[:, 2:]).clamp(min=TINY * distance)
    return float((sight.half * depths / lateral).min())


def level_axes(up: Float[Tensor, "3"]) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Two directions at right angles to up, and to each other."""
    side = torch.linalg.cross(up, torch.eye(3).to(up)[up.abs().argmin()])
    side = torch.nn.functional.normalize(side, dim=0)
    return side, torch.linalg.cross(up, side)


def centred_K(focal: float, size: tuple[int, int]) -> Float[Tensor, "3 3"]:
    """Intrinsics of a camera that looks at the middle of its picture."""
    width, height = size
    return torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])


def _distance(offsets: Float[Tensor, "M 3"], radius: float, slopes: Float[Tensor, "2"]) -> float:
    """From where all is in the picture, and well before the camera."""
    needed = (offsets[:, :2].abs() / slopes).amax(dim=1).clamp(min=CLEAR * radius)
    return float((needed - offsets[:, 2]).max())


def _free(content: Content, sight: Sight, radius: float) -> float:
    """How far one can go before something else hides the middle of the content."""
    offsets = content.others - sight.focus
    ahead = offsets @ sight.outward
    aside = (offsets.square().sum(dim=1) - ahead.square()).clamp(min=0).sqrt()
    within = MIDDLE * radius
    between = (ahead > 0) & (aside < within + content.blurs)
    blurs = content.blurs[between]
    along, order = (ahead[between] - blurs).sort()
    shares = content.areas[between] / (torch.pi * (within**2 + blurs.square()))
    walls = along[shares[order].cumsum(0) > HIDDEN]
    return float(walls[0]) if len(walls) else float("inf")
