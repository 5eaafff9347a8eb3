"""What painting starts from: the object in the painting's colours."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.scene.splats import Splats
from stylesplat.stylization.color import transfer_colors, vary_colors
from stylesplat.stylization.object_views import ObjectView
from stylesplat.stylization.style_config import StyleConfig


@torch.no_grad()
def undercoat(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    views: Sequence[ObjectView],
    palette: Float[Tensor, "P 3"],
    config: StyleConfig,
) -> Splats:
    """The colours to start from.

    Args:
        splats: The scene, with as much of the object's own pattern as is wanted.
        picked: The object's Gaussians.
        views: Whose pixels tell its colours.
        palette: Colours in 0..1, that it is to have.
        config: The settings.
    """
    if config.color != "free":
        splats = vary_colors(splats, picked, seed=config.seed)
        splats = transfer_colors(splats, picked, palette, views)
    if config.view_dependence == "drop":
        matte = splats.shN.masked_fill(picked[:, None, None], 0)
        splats = replace(splats, shN=matte)
    return splats
