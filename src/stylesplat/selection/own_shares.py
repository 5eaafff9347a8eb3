"""What of a pick `stylize` paints, and how much: told before anything is painted."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.selection.contacts import on_support
from stylesplat.selection.soft_picks import find_places, soft_shares


@torch.no_grad()
def own_shares(
    splats: Splats, picked: Bool[Tensor, " N"], cameras: Cameras, *, seed: int = 0
) -> Float[Tensor, " N"]:
    """How much of what each Gaussian paints belongs to the object that it was picked for.

    Args:
        splats: The scene.
        picked: The object's Gaussians.
        cameras: Views to look in.
        seed: Of the planes that are tried for what the object stands on.

    Returns:
        Shares in 0..1: 0 for what lies on the surface that the object stands on, for haze and for
        floaters, and for all that is not picked.
    """
    own = picked & ~on_support(splats, picked, seed=seed)
    return soft_shares(splats, own, find_places(splats, own, cameras))
