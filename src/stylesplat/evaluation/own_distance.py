"""How far a style is from itself: what 'as close as the painting' means."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.style_image import resize, style_features

PLACES = 2048  # of all pictures that are looked up
AT_ONCE = 256  # of them, as block 1 has a feature per pixel
NOWHERE = -2.0  # below any cosine


@torch.no_grad()
def own_nnfm(
    pictures: Sequence[Float[Tensor, "_ _ 3"]],
    network: FeatureNetwork,
    blocks: Sequence[int],
    *,
    length: float,
) -> float | None:
    """NNFM between places of a style and the rest of it.

    Each feature is compared with all that see nothing of what it sees. A new picture by the same
    hand would hardly come closer, so this, not 0, is what an object can be expected to reach.

    Args:
        pictures: Of the style, colours in 0..1.
        network: Whose features are compared.
        blocks: Layer groups; their distances are averaged.
        length: Longer side of the pictures in pixels.

    Returns:
        The mean cosine distance; None if the pictures are too small to hold two such places.

    Raises:
        StyleSplatError: If a picture has no whole feature.
    """
    distances = [_of_block(pictures, network, block, length) for block in blocks]
    if any(len(each) == 0 for each in distances):
        return None
    return float(torch.stack([each.mean() for each in distances]).mean())


def share_of_way(before: float, after: float, own: float) -> float | None:
    """How far an object has come from what it was to its style, as NNFM has it.

    Args:
        before: Its distance before.
        after: Its distance now.
        own: The style's from itself, which is the whole way.

    Returns:
        0 to 1; None if it was there before, so that there was no way to go.
    """
    if before <= own:
        return None
    return min(1.0, max(0.0, (before - after) / (before - own)))


def _of_block(
    pictures: Sequence[Tensor], network: FeatureNetwork, block: int, length: float
) -> Float[Tensor, " P"]:
    """The distance of some features from their nearest elsewhere; of none that has no other."""
    features, places = [], []
    for number, picture in enumerate(pictures):
        (rows,) = style_features(picture, network, [block], length=length)
        features.append(F.normalize(rows.float(), dim=1))
        places.append(_places(resize(picture, length), network, block, number))
    found, at = torch.cat(features), torch.cat(places)
    cells = network.cells(block)
    closest = []
    for some in torch.arange(0, len(found), 1 + len(found) // PLACES).split(AT_ONCE):
        gaps = (at[some, None] - at[None]).abs().amax(dim=-1)
        apart = gaps * cells.stride >= cells.size
        closest.append((found[some] @ found.T).where(apart, NOWHERE).amax(dim=1))
    cosines = torch.cat(closest)
    return 1 - cosines[cosines > NOWHERE]


def _places(
    picture: Tensor, network: FeatureNetwork, block: int, number: int
) -> Float[Tensor, "P 3"]:
    """Picture, row and column of every feature, in cells; pictures are infinitely far apart."""
    cells = network.cells(block)
    inside = (cells.inside(side) for side in picture.shape[:2])
    rows, columns = (torch.arange(each.stop - each.start) for each in inside)
    grid = torch.cartesian_prod(rows, columns).float().to(picture.device)
    return F.pad(grid, (1, 0), value=number * 1e6)
