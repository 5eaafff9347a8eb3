"""The style image in the sizes that strokes ask for, and the features to be matched."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.io.style_pictures import resize
from stylesplat.stylization.config import USUAL_SCALE
from stylesplat.stylization.features.network import FeatureNetwork

SHOCKS = 4.0  # steps of the filter that coarsens a style image, for every unit of scale
MAX_COARSENED = 8.0  # scale: beyond it strokes are as large as pictures
RIDGE = 0.06  # curvature across a stroke, of 1: less is no stroke
LARGEST = 1300.0  # pixels of a resized style image's longer side: of a larger one parts are used
BROAD = 0.05  # of the object's length: what is less is a stroke
PARTS = 9  # that together are as large


@torch.no_grad()
def style_features(
    style: Float[Tensor, "H W 3"], network: FeatureNetwork, block: int, *, length: float
) -> Float[Tensor, "Q D"]:
    """The features of a block, of a style image of this longer side in pixels.

    Features that see past the border are left out, so its padding is in no style.
    """
    resized, cells = fit_style(style, network, block, length), network.cells(block)
    rows, columns = map(cells.inside, resized.shape[:2])
    return network(resized, [block])[0][rows, columns].flatten(0, 1)


def fit_style(
    style: Float[Tensor, "H W 3"], network: FeatureNetwork, block: int, length: float
) -> Float[Tensor, "_ _ 3"]:
    """The style image with this longer side, or as large as it takes to hold a whole feature."""
    cells = network.cells(block)
    least = cells.size + cells.stride - 1  # wherever its cell lies
    return resize(style, max(length, least * max(style.shape[:2]) / min(style.shape[:2])))


def all_colors(pictures: Sequence[Float[Tensor, "_ _ 3"]]) -> Float[Tensor, "P 3"]:
    return torch.cat([picture.reshape(-1, 3) for picture in pictures])


def coarsen_style(picture: Float[Tensor, "H W 3"], scale: float) -> Float[Tensor, "H W 3"]:
    """A style image for a larger scale than usual: fine strokes are joined into crisp large ones.

    A coherence-enhancing shock filter (Weickert 2003): across the flow of the strokes, bright
    ridges and dark ones grow until they meet.
    """
    if scale <= USUAL_SCALE:
        return picture
    scale = min(scale, MAX_COARSENED)
    width, square = scale / 2, np.ones((3, 3))
    image = resize(picture, min(LARGEST, float(max(picture.shape[:2])))).cpu().numpy()
    image = cv2.GaussianBlur(image, (0, 0), width / 2)  # else extremes would grow
    for _ in range(round(SHOCKS * (scale - USUAL_SCALE))):
        smooth = cv2.GaussianBlur(image, (0, 0), width / 2)
        grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (0, 0), width)
        eigen = cv2.cornerEigenValsAndVecs(grey, 4 * round(width) + 3, 3)
        x, y = eigen[..., 2], eigen[..., 3]  # across the flow
        xx, xy, yy = (cv2.Sobel(grey, cv2.CV_32F, *order) for order in ((2, 0), (1, 1), (0, 2)))
        ridge = width**2 * (x**2 * xx + 2 * x * y * xy + y**2 * yy)[..., None] / RIDGE
        grown = np.where(ridge < 0, cv2.dilate(image, square), cv2.erode(image, square))
        image = cv2.addWeighted(image, 0.5, np.where(abs(ridge) > 1, grown, smooth), 0.5, 0)
    return torch.from_numpy(image).to(picture)


def without_strokes(pictures: Sequence[Tensor], scale: float) -> list[Tensor]:
    """Style images so small that only large shapes are left: strokes melt into their mean.

    Shapes of an object that take these colours leave the rest of a style's contrast to strokes.
    """
    return [resize(each, min(scale / BROAD, float(max(each.shape[:2])))) for each in pictures]


def style_parts(
    picture: Float[Tensor, "H W 3"], length: float, generator: torch.Generator
) -> list[tuple[Float[Tensor, "_ _ 3"], float]]:
    """A style image, or random parts of one whose longer side is to have very many pixels.

    With each comes its share of that side.
    """
    if length <= LARGEST:
        return [(picture, 1.0)]
    longer = max(picture.shape[:2])
    side = longer * LARGEST / length / 3
    down, across = (max(1, int(size / side)) for size in picture.shape[:2])
    parts = [part for rows in picture.chunk(down) for part in rows.chunk(across, dim=1)]
    chosen = torch.randperm(len(parts), generator=generator)[:PARTS].tolist()
    return [(parts[i], max(parts[i].shape[:2]) / longer) for i in chosen]
