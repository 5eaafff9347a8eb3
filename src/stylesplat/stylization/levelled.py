"""Paint without what is finer than the strokes: Gaussians in the colours that surround them."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.rendering.sh import SH_C0
from stylesplat.scene.splats import Splats
from stylesplat.stylization.object_views import HIDDEN, ObjectView


@torch.no_grad()
def levelled(
    splats: Splats, picked: Bool[Tensor, " N"], views: Sequence[ObjectView], share: float
) -> Splats:
    """Let Gaussians take on some of the colour of the pixels that they are part of.

    What renders of this size do not show, nothing has matched: there Gaussians differ by chance,
    and along the lines of the object's own pattern.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        views: As small as the strokes are large.
        share: How much: 0 changes nothing.
    """
    if share == 0:
        return splats
    matte = replace(splats, shN=splats.shN.masked_fill(picked[:, None, None], 0))
    total, weights = torch.zeros_like(splats.sh0), torch.zeros_like(splats.sh0)
    for view in views:
        image, own = view.render(matte), view.pixels[..., None]
        total += view.carried(matte, image * own)
        weights += view.carried(matte, own.expand_as(image).to(image))
    around = (total / weights.clamp(min=HIDDEN) - 0.5) / SH_C0
    seen = picked[:, None, None] & (weights > HIDDEN)
    return replace(splats, sh0=torch.where(seen, splats.sh0.lerp(around, share), splats.sh0))
