"""The optimisation of an object's colours against style features."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.rendering.sh import sh0_from_rgb
from stylesplat.scene.sampling import drawn
from stylesplat.scene.splats import Splats
from stylesplat.stylization.color import mixed_colors
from stylesplat.stylization.near_palette import DARKEST
from stylesplat.stylization.object_views import ObjectView, weights_in, with_fixed_bands
from stylesplat.stylization.objective import Objective, ViewTarget
from stylesplat.training.adam import Moments, adam_step

SHN_SLOWDOWN = 20  # the official code's ratio of the rates of sh0 and shN
TRUSTED = 0.25  # of the median weight: Gaussians that show less take accordingly smaller steps


@dataclass(frozen=True)
class Step:
    """One step of the optimisation."""

    number: int
    """Counted from 1."""
    nnfm: float
    """The loss before the step, in the view that was drawn."""
    splats: Splats
    """After the step."""
    paint: Splats
    """The same with each Gaussian's paint in full, whatever its share: what to go on from."""


def optimize_colors(
    paint: Splats,
    base: Splats,
    shares: Float[Tensor, " N"],
    targets: Sequence[ViewTarget],
    objective: Objective,
    steps: int,
) -> Iterator[Step]:
    """Move the colours of an object's Gaussians until its features match the style's.

    Args:
        paint: The scene, without gradients, its object in the paint to start from.
        base: The scene before, of which Gaussians keep what is not the object's share.
        shares: How much of its paint each Gaussian takes on.
        targets: Views of the object; one is drawn per step.
        objective: What to minimise; its settings are the rates and the seed.
        steps: How many to take.

    Yields:
        Every step; whoever stops asking keeps the last one's splats.
    """
    config = objective.config
    generator = torch.Generator().manual_seed(config.seed)
    picked = shares > 0
    rows = picked.nonzero()[:, 0]
    part = shares[rows, None, None]
    fields = ("sh0", "shN") if config.view_dependence == "train" else ("sh0",)
    leaves = {name: getattr(paint, name)[rows].requires_grad_() for name in fields}
    own = {name: getattr(base, name)[rows] for name in fields}
    rates = {"sh0": config.lr, "shN": config.lr / SHN_SLOWDOWN}
    moments = Moments.zeros(leaves)
    shown = mixed_colors(base, paint, shares)
    views = [target.view for target in targets]
    if "shN" not in leaves:
        views = with_fixed_bands(views, shown)
        pairs = zip(targets, views, strict=True)
        targets = [replace(target, view=view) for target, view in pairs]
    trust = None if config.hard else _trust(base, picked, views)
    for number, target in enumerate(drawn(targets, steps, generator), start=1):
        with torch.enable_grad():  # a viewer may well have turned it off
            losses = objective(target, shown.with_rows(rows, _mixed_rows(own, leaves, part)))
            losses.total.backward()
        before = {name: leaf.detach().clone() for name, leaf in leaves.items()}
        decayed = config.final_lr ** ((number - 1) / steps)
        adam_step(leaves, moments, {name: rate * decayed for name, rate in rates.items()}, number)
        with torch.no_grad():
            for name, leaf in leaves.items():
                if trust is not None:
                    leaf.copy_(torch.lerp(before[name], leaf, trust))
                leaf.grad = None
        if "shN" not in leaves:
            _keep_in_range(leaves["sh0"])
        after = shown.with_rows(rows, _mixed_rows(own, leaves, part)).detach()
        full = paint.with_rows(rows, leaves).detach()
        yield Step(number, losses.style.item(), after, full)


def _trust(
    splats: Splats, picked: Bool[Tensor, " N"], views: Sequence[ObjectView]
) -> Float[Tensor, "M 1 1"]:
    """How far to follow each Gaussian's steps: Adam's are as long for those that hardly show."""
    weights = weights_in(views, splats, picked)
    typical = weights[weights > 0].median()
    return (weights / (weights + TRUSTED * typical))[:, None, None]


def _mixed_rows(
    own: dict[str, Tensor], leaves: dict[str, Tensor], part: Tensor
) -> dict[str, Tensor]:
    """As `mixed_colors`, of some rows, with gradients."""
    return {name: torch.lerp(own[name], leaf, part) for name, leaf in leaves.items()}


@torch.no_grad()
def _keep_in_range(sh0: Tensor) -> None:
    """Colours that the rasteriser clamps at 0 would have no gradient to come back by."""
    black, white = sh0_from_rgb(torch.tensor([[DARKEST], [1.0]]).expand(2, 3)).to(sh0)
    sh0.clamp_(black, white)
