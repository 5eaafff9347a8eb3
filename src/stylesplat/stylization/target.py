"""The style image, as the features that an object is to take on."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.features.network import FeatureNetwork


@torch.no_grad()
def style_features(
    style: Float[Tensor, "H W 3"], network: FeatureNetwork, blocks: Sequence[int], *, length: float
) -> tuple[Float[Tensor, "_ _"], ...]:
    """Features of a style image resized to `length` pixels along its longer side.

    Features that see past the border are left out, so its padding is in no style.

    Args:
        style: Colours in 0..1, of any size and shape.
        network: The feature network.
        blocks: Which blocks of it.
        length: In pixels.

    Returns:
        For each block the features, one per row.

    Raises:
        StyleSplatError: If the style image is smaller than what one feature depends on.
    """
    check_size(style, network, blocks, length=length)
    cells = [network.cells(block) for block in blocks]
    resized = resize(style, length)
    feats = network(resized, blocks)
    rows = []
    for c, image in zip(cells, feats, strict=True):
        inside = image[c.inside(resized.shape[0]), c.inside(resized.shape[1])]
        rows.append(inside.reshape(-1, image.shape[-1]))
    return tuple(rows)


def check_size(
    style: Float[Tensor, "H W 3"], network: FeatureNetwork, blocks: Sequence[int], *, length: float
) -> None:
    """Raise a StyleSplatError if the style image has no whole feature; see `style_features`."""
    needed = _least_side(network, blocks)
    height, width = style.shape[:2]
    _refuse_small((width, height), needed, "it is", "Choose a larger picture.")
    size = _fitted(width, height, length)
    _refuse_small(size, needed, "for this object it becomes", "Raise the style scale.")


def fits(
    style: Float[Tensor, "H W 3"], network: FeatureNetwork, blocks: Sequence[int], *, length: float
) -> bool:
    """Whether the style image has a whole feature if it is resized; see `style_features`."""
    height, width = style.shape[:2]
    return min(_fitted(width, height, length)) >= _least_side(network, blocks)


def resize(image: Float[Tensor, "H W 3"], length: float) -> Float[Tensor, "_ _ 3"]:
    """The image with a longer side of `length` pixels, its shape kept."""
    height, width = image.shape[:2]
    size = _fitted(width, height, length)
    planes = image.permute(2, 0, 1)[None]
    resized = F.interpolate(planes, size[::-1], mode="bicubic", antialias=True)
    return resized[0].permute(1, 2, 0).clamp(0, 1)


def _least_side(network: FeatureNetwork, blocks: Sequence[int]) -> int:
    """Pixels that hold a whole feature wherever its cell lies."""
    return max(c.size + c.stride - 1 for c in map(network.cells, blocks))


def _fitted(width: int, height: int, length: float) -> tuple[int, int]:
    factor = length / max(height, width)
    return max(1, round(width * factor)), max(1, round(height * factor))


def _refuse_small(size: tuple[int, int], needed: int, what: str, remedy: str) -> None:
    width, height = size
    if min(height, width) < needed:
        raise StyleSplatError(
            f"Cannot take the style from this picture: {what} {width}x{height} pixels, and its "
            f"features span {needed}. {remedy}"
        )
