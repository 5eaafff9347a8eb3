"""Objects may be repainted, and colour cannot paint finer than the Gaussians are."""

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

CERTAIN = 0.95  # probability; a hole in the background would show


@torch.no_grad()
def object_share(splats: Splats) -> Float[Tensor, " N"] | None:
    """Probability of each Gaussian to belong to any object; None without identities."""
    if splats.identities is None or splats.classifier is None:
        return None
    scores = splats.classifier.some_at_a_time(splats.identities)
    return torch.cat([1 - some.softmax(dim=-1)[:, 0] for _, some in scores])


@torch.no_grad()
def growth_preference(splats: Splats, object_growth: float) -> Float[Tensor, " N"] | None:
    """How much likelier than others Gaussians are to be copied."""
    share = object_share(splats)
    return None if share is None else 1 + (object_growth - 1) * share


@torch.no_grad()
def limit_sizes(splats: Splats, cameras: Cameras, pixels: float) -> None:
    """Shrink the Gaussians of objects that are too large, in place.

    Args:
        splats: Gaussians, of which `scales` change.
        cameras: Where the photos were taken, at the size trained at.
        pixels: Largest standard deviation, seen from the cameras' median distance.
    """
    share = object_share(splats)
    if share is None or not (inside := share > CERTAIN).any():
        return
    middle = splats.means[inside].median(dim=0).values
    distance = (cameras.positions.to(middle) - middle).norm(dim=-1).median()
    limit = pixels * distance / cameras.Ks[:, 0, 0].median().to(middle)
    splats.scales[inside] = splats.scales[inside].clamp(max=float(limit.log()))
