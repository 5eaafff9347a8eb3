"""Colours of one photo from those of the scene: an affine map, for exposure and white balance.

The map acts on sRGB values, as in INRIA's code and gsplat. There it matches gains of 0.6 to 1.6 in
linear light, with a tint, to 58 dB, as measured on photos; but for what is blown out.
"""

import torch
from jaxtyping import Float
from torch import Tensor

BLOWN_OUT = 0.99  # of a photo's channel: how bright the scene was there cannot be told
FIT_PRIOR = 1e-4  # pull towards no change, over the mean square of what is fitted with


def mapped(
    image: Float[Tensor, "H W 3"], alpha: Float[Tensor, "H W 1"], change: Float[Tensor, "3 4"]
) -> Float[Tensor, "H W 3"]:
    """A render in the colours of a photo.

    Args:
        image: Rendered over black.
        alpha: Its coverage, which the offset is laid on: black behind everything stays black.
        change: What is added to the colours, per colour and coverage; 0 changes nothing.
    """
    return image + torch.cat([image, alpha], dim=-1) @ change.mT


def fitted(
    image: Float[Tensor, "H W 3"], alpha: Float[Tensor, "H W 1"], photo: Float[Tensor, "H W 3"]
) -> Float[Tensor, "3 4"]:
    """The change with which a render is closest to a photo, by ridge regression.

    Pixels that are blown out in the photo do not count.

    Args:
        image: Rendered over black.
        alpha: Its coverage.
        photo: In 0..1, over black.
    """
    inputs = torch.cat([image, alpha], dim=-1).flatten(0, 1).double()
    missing = (photo - image).flatten(0, 1).double()
    weights = (photo < BLOWN_OUT).all(dim=-1).flatten()[:, None].to(inputs)
    matrix = (weights * inputs).T @ inputs
    prior = FIT_PRIOR * matrix.trace().clamp(min=1) * torch.eye(4).to(matrix)
    return torch.linalg.solve(matrix + prior, (weights * inputs).T @ missing).T.to(image)


def aim(image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]) -> Float[Tensor, "H W 3"]:
    """The target, but what is blown out in it is as bright as a brighter image."""
    brighter = torch.maximum(image.detach(), target)
    return torch.where(target >= BLOWN_OUT, brighter, target)
