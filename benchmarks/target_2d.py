"""The best that any 3D result could do in one view: its pixels, optimised for exact NNFM."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from judge import Sight, own_features
from torch import Tensor

from stylesplat.progress import track
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.matching import nnfm_loss

RATE, LAST_RATE = 0.02, 0.1  # of Adam on colours in 0..1; the last one as a share of the first
MOST = 8192  # of the painting's features at a size, evenly chosen: all take minutes a view
OWN = 2048  # of the object's features at a size, other ones in each step
PULL, COLORS = 10.0, 256  # weight of the squared way to the nearest of so many of its colours
TINY = 1e-6  # least variance of a colour


def target_2d(
    sight: Sight,
    palette: Float[Tensor, "Q 3"],
    targets: Sequence[tuple[float, Float[Tensor, "_ _"]]],
    network: FeatureNetwork,
    steps: int,
) -> Float[Tensor, "H W 3"]:
    """The view with the object's pixels as free as can be.

    They start from the palette's mean and covariance, and end there; on the way they are pulled
    to its colours, without which the networks are content with grain. Every step adds the losses
    at all sizes. What the object covers in part is blended with what is there.

    Args:
        sight: The view.
        palette: The painting's colours, in 0..1.
        targets: Sizes, as shares of the photo's, and the painting's features there.
        network: Whose features are matched.
        steps: Of Adam.
    """
    share = sight.share[..., None]
    few = [(size, feats[:: 1 + len(feats) // MOST].float()) for size, feats in targets]
    leaf = _matched(sight, sight.before, palette).requires_grad_()
    generator = torch.Generator().manual_seed(0)
    optimizer = torch.optim.Adam([leaf], lr=RATE)
    scheduler = torch.optim.lr_scheduler.ExponentialLR(optimizer, LAST_RATE ** (1 / steps))
    for _ in track(range(steps), "painting the pixels"):
        optimizer.zero_grad()
        shown = sight.before.lerp(leaf, share)
        losses = []
        for size, feats in few:
            own = own_features(sight, shown, network, size)
            drawn = torch.randperm(len(own), generator=generator)[:OWN]
            losses.append(nnfm_loss(own[drawn], feats))
        losses.append(PULL * _far_from(palette, leaf[sight.mask]))
        torch.stack(losses).sum().backward()
        optimizer.step()
        scheduler.step()
        leaf.data.clamp_(0, 1)
    return sight.before.lerp(_matched(sight, leaf.detach(), palette), share)


def _far_from(palette: Float[Tensor, "Q 3"], colors: Float[Tensor, "P 3"]) -> Float[Tensor, ""]:
    """The mean squared distance from the nearest of the palette's colours."""
    few = palette[:: 1 + len(palette) // COLORS]
    nearest = torch.cat(
        [torch.cdist(part, few).argmin(dim=1) for part in colors.detach().split(OWN)]
    )
    return (colors - few[nearest]).square().sum(dim=1).mean()


def _matched(sight: Sight, image: Tensor, palette: Tensor) -> Tensor:
    """A picture with the palette's mean and covariance where the object is."""
    own = image[sight.mask]
    map = _power(own, -0.5) @ _power(palette, 0.5)
    return ((image - own.mean(dim=0)) @ map + palette.mean(dim=0)).clamp(0, 1)


def _power(colors: Float[Tensor, "P 3"], exponent: float) -> Float[Tensor, "3 3"]:
    """A power of the covariance of some colours."""
    values, vectors = torch.linalg.eigh(colors.T.cov())
    return (vectors * values.clamp(min=TINY) ** exponent) @ vectors.T
