"""Renders fitted to photos without being judged by what they were fitted on: half by half."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.training.color_maps import fitted, mapped

Fit = Callable[[slice], Float[Tensor, "H W 3"]]
"""From the columns that may be looked at to a render of the whole."""


def half_by_half(fit: Fit, width: int) -> Float[Tensor, "H W 3"]:
    """A render whose halves were each fitted on the other half of the photo."""
    left, right = slice(None, width // 2), slice(width // 2, None)
    return torch.cat([fit(right)[:, left], fit(left)[:, right]], dim=1)


def recolored(
    splats: Splats, camera: Cameras, photo: Float[Tensor, "H W 3"]
) -> Float[Tensor, "H W 3"]:
    """The render of a camera in the colours of its photo; no pixel's own colour is used for it."""
    image, alpha, _ = rasterize(splats, camera)

    def fit(seen: slice) -> Float[Tensor, "H W 3"]:
        change = fitted(image[0, :, seen], alpha[0, :, seen], photo[:, seen])
        return mapped(image[0], alpha[0], change)

    return half_by_half(fit, photo.shape[1])
