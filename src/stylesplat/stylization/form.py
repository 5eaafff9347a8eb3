"""The form of an object: the luminance detail that people recognise it by.

Form is detail that stands out locally: eyes, a mouth, a fold, an edge. Detail that the object has
everywhere (a pattern, fur, a weave) is decoration, which the style replaces.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.metrics.lab import LUMA
from stylesplat.rendering.render import rasterize
from stylesplat.scene.splats import Splats
from stylesplat.stylization.colors import HIDDEN, smooth
from stylesplat.stylization.views import ObjectView

BAND_DEVIATIONS = (0.004, 0.015, 0.05)  # of blurs whose differences are bands, in lengths
ENERGY_DEVIATION = 0.03  # of the blur that averages a band's energy, in lengths
SALIENT = 1.5  # times the median energy: less is pattern
SURVEY_LENGTH = 96.0  # pixels of the object's longer side where bands are compared
# Deviation of a band's energy over the object, of its mean: of pattern, and what counts in full.
# The demo's vase and teapot have .67 to .75, a doll .89, fox and a face 1.1 to 1.5.
EVEN, UNEVEN = 0.75, 0.88
TINY = 1e-6  # energy of a band that the object hardly has
FLAT_WEIGHT = 0.3  # weight of pixels where nothing stands out: paint stays calm there


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
def form_shares(
    images: Sequence[Float[Tensor, "_ _ 3"]], masks: Sequence[Bool[Tensor, "_ _"]], length: float
) -> list[float]:
    """The share of an object's detail that is form, by bands; 0 where it is alike everywhere.

    Args:
        images: Views of the whole unpainted object.
        masks: The object's pixels in each.
        length: The object's longer side in these views, in pixels.
    """
    energies = [
        [smooth(band.square(), mask, ENERGY_DEVIATION * length)[mask] for band in bands]
        for mask, bands in (
            (mask, luminance_bands(image, mask, length))
            for image, mask in zip(images, masks, strict=True)
        )
    ]
    shares = []
    for views in zip(*energies, strict=True):
        energy = torch.cat(views)
        variation = float(energy.std() / (energy.mean() + TINY))
        shares.append(min(max((variation - EVEN) / (UNEVEN - EVEN), 0.0), 1.0))
    return shares


@torch.no_grad()
def measure_form(
    image: Float[Tensor, "H W 3"],
    mask: Bool[Tensor, "H W"],
    length: float,
    shares: Sequence[float],
) -> Form:
    """Find the form in a picture of the unpainted object.

    Args:
        image: The unpainted view.
        mask: The object's pixels.
        length: The longer side of the whole object, in pixels.
        shares: Of the bands; see `form_shares`.
    """
    details, weights = [], []
    for band in luminance_bands(image, mask, length):
        energy = smooth(band.square(), mask, ENERGY_DEVIATION * length)
        typical = SALIENT * energy[mask].median()
        weight = (1 - typical / energy.clamp(min=1e-9)).clamp(min=0) * mask
        detail = weight * band
        details.append(detail)
        weights.append((weight + FLAT_WEIGHT) * mask)
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
    before: Splats,
    splats: Splats,
    mask: Bool[Tensor, " N"],
    views: Sequence[ObjectView],
    length: float,
    shares: Sequence[float],
) -> Float[Tensor, " N"]:
    """The form of an object as luminance that each of its Gaussians adds, averaged over views.

    Adding some of it to painted colours, or taking it away, changes the form in closed form.

    Args:
        before: The unpainted scene.
        splats: The Gaussians that are painted.
        mask: Those of the object.
        views: Of the whole object.
        length: The object's longer side in these views, in pixels.
        shares: Of the bands; see `form_shares`.

    Returns:
        In -1..1; 0 for Gaussians that are not the object's or hardly show.
    """
    matte = replace(splats, shN=splats.shN.masked_fill(mask[:, None, None], 0))
    total, weights = torch.zeros_like(splats.opacities), torch.zeros_like(splats.opacities)
    for view in views:
        image = rasterize(before, view.camera)[0][0]
        form = measure_form(image, view.pixels, length, shares)
        pairs = zip(form.details, form.shares, strict=True)
        detail = torch.stack([share * detail for detail, share in pairs]).sum(dim=0)
        image = torch.stack([detail, view.pixels.to(detail), torch.zeros_like(detail)], dim=2)
        sums = view.backproject(matte, image)
        total += sums[:, 0, 0]
        weights += sums[:, 0, 1]
    relief = (total / weights.clamp(min=HIDDEN)).clamp(-1, 1)  # renders may be brighter than 1
    return torch.where(mask & (weights > HIDDEN), relief, 0)


def luminance_bands(
    image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"], length: float
) -> list[Float[Tensor, "H W"]]:
    """Luminance between each two of `BAND_DEVIATIONS`, inside the mask alone; 0 elsewhere."""
    luma = image @ image.new_tensor(LUMA) * mask
    levels = [smooth(luma, mask, size * length) for size in BAND_DEVIATIONS]
    return [fine - coarse for fine, coarse in pairwise(levels)]
