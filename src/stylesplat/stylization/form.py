"""The form of an object: the luminance detail that people recognise it by, kept while painting.

Detail that stands out from what the object has everywhere is form: eyes, a mouth, a fold, an edge.
Detail that it has everywhere (a pattern, fur, a weave) is decoration, which the style replaces.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.metrics.lab import LUMA
from stylesplat.scene.splats import Splats
from stylesplat.stylization.object_views import HIDDEN, ObjectView

SIZES = (0.004, 0.015, 0.05)  # deviations between which the bands lie, of the object's length
AROUND = 0.03  # deviation of the mean of a band's energy, of the object's length
EVERYWHERE = 1.5  # of the median energy: that much the object has everywhere
STANDING_OUT = 0.25  # share of a band's energy from which it counts in full
ELSEWHERE = 0.3  # weight of pixels where nothing stands out: paint stays calm there
LEAST = 0.5  # pixels of a deviation; less blurs nothing


@dataclass(frozen=True)
class Form:
    """The form that one view shows, by bands of size."""

    details: Sequence[Float[Tensor, "H W"]]
    """Luminance that stands out, in 0..1 units."""
    weights: Sequence[Float[Tensor, "H W"]]
    """How much each pixel counts."""
    shares: Sequence[float]
    """How much each band counts: 0 if the object has its detail everywhere."""


@torch.no_grad()
def measure_form(image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"], length: float) -> Form:
    """Find the form in a picture of the unpainted object.

    Args:
        image: The unpainted view.
        mask: The object's pixels.
        length: The longer side of the whole object, in pixels.
    """
    details, weights, shares = [], [], []
    for band in luminance_bands(image, mask, length):
        energy = smooth(band.square(), mask, AROUND * length)
        typical = EVERYWHERE * energy[mask].median()
        weight = (1 - typical / energy.clamp(min=1e-9)).clamp(min=0) * mask
        detail = weight * band
        share = detail.square().sum() / band.square().sum().clamp(min=1e-9)
        details.append(detail)
        weights.append((weight + ELSEWHERE) * mask)
        shares.append(min(1.0, float(share) / STANDING_OUT))
    return Form(details, weights, shares)


def form_distance(
    image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"], length: float, form: Form
) -> Float[Tensor, ""]:
    """1 minus the weighted correlation of a painted view's luminance with the form, over bands."""
    total = image.new_zeros(())
    known = zip(form.details, form.weights, form.shares, strict=True)
    for band, (detail, weight, share) in zip(
        luminance_bands(image, mask, length), known, strict=True
    ):
        norms = (weight * band.square()).sum() * (weight * detail.square()).sum()
        correlation = (weight * band * detail).sum() / (norms + 1e-12).sqrt()
        total = total + share * (1 - correlation)
    return total


@torch.no_grad()
def form_relief(
    splats: Splats, picked: Bool[Tensor, " N"], views: Sequence[ObjectView], length: float
) -> Float[Tensor, " N"]:
    """The form of an object as luminance that each of its Gaussians adds, averaged over views.

    Adding some of it to painted colours, or taking it away, changes the form in closed form.

    Args:
        splats: The unpainted scene.
        picked: The object's Gaussians.
        views: Of the whole object.
        length: The object's longer side in these views, in pixels.

    Returns:
        In -1..1; 0 for Gaussians that are not picked or hardly show.
    """
    matte = replace(splats, shN=splats.shN.masked_fill(picked[:, None, None], 0))
    total, weights = torch.zeros_like(splats.opacities), torch.zeros_like(splats.opacities)
    for view in views:
        form = measure_form(view.render(splats), view.pixels, length)
        pairs = zip(form.details, form.shares, strict=True)
        detail = torch.stack([share * detail for detail, share in pairs]).sum(dim=0)
        image = torch.stack([detail, view.pixels.to(detail), torch.zeros_like(detail)], dim=2)
        sums = view.carried(matte, image)
        total += sums[:, 0, 0]
        weights += sums[:, 0, 1]
    relief = (total / weights.clamp(min=HIDDEN)).clamp(-1, 1)  # renders may be brighter than 1
    return torch.where(picked & (weights > HIDDEN), relief, 0)


def luminance_bands(
    image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"], length: float
) -> list[Float[Tensor, "H W"]]:
    """Luminance between each two of `SIZES`, inside the mask alone; 0 elsewhere."""
    luma = image @ image.new_tensor(LUMA) * mask
    levels = [smooth(luma, mask, size * length) for size in SIZES]
    return [fine - coarse for fine, coarse in pairwise(levels)]


def smooth(
    values: Float[Tensor, "H W"], mask: Bool[Tensor, "H W"], deviation: float
) -> Float[Tensor, "H W"]:
    """A Gaussian blur of values inside a mask, to which what lies outside adds nothing."""
    if deviation < LEAST:
        return values * mask
    inside = mask.to(values)
    return inside * _blur(values * inside, deviation) / _blur(inside, deviation).clamp(min=1e-3)


def _blur(values: Float[Tensor, "H W"], deviation: float) -> Float[Tensor, "H W"]:
    """A Gaussian blur with zeros around, of no particular sum: two products of matrices."""
    height, width = values.shape
    return _kernel(height, deviation).to(values) @ values @ _kernel(width, deviation).to(values)


@lru_cache(maxsize=32)
def _kernel(size: int, deviation: float) -> Float[Tensor, "S S"]:
    places = torch.arange(size, dtype=torch.float32)
    return (-((places[:, None] - places) / deviation).square() / 2).exp()
