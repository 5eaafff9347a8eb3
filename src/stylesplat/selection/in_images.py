"""Which images an object lies in, without rendering any."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import solid
from stylesplat.scene.projection import shown
from stylesplat.scene.splats import Splats

SAMPLE = 1000  # points of an object that are projected into every image


def in_images(surface: Float[Tensor, "M 3"], cameras: Cameras) -> Float[Tensor, " C"]:
    """The share of an object's points that lies in each image, though something may hide them."""
    points = surface[:: max(1, len(surface) // SAMPLE)].to(cameras.viewmats)
    return torch.stack([shown(points, cameras[row]).float().mean() for row in range(len(cameras))])


def in_any_image(splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]) -> bool:
    """Whether picked Gaussians lie in any image, though something may hide them."""
    return bool((in_images(splats.means[solid(splats, picked)], cameras) > 0).any())
