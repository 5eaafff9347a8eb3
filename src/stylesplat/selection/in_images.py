"""Which images an object lies in, without rendering any."""

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import shown

SAMPLE = 1000  # points of an object that are projected into every image


def in_images(surface: Float[Tensor, "M 3"], cameras: Cameras) -> Float[Tensor, " C"]:
    """The share of an object's points that lies in each image, though something may hide them."""
    points = surface[:: max(1, len(surface) // SAMPLE)].to(cameras.viewmats)
    return torch.stack([shown(points, cameras[row]).float().mean() for row in range(len(cameras))])
