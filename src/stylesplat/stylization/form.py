"""The form of an object: the detail that people recognise it by.

Form is detail that stands out locally: eyes, a mouth, a fold, an edge. Detail that the object has
everywhere (a pattern, fur, a weave) is decoration, which the style replaces. Letters are form, too:
they cover a sign almost as evenly as a pattern does, but have two values. Paint shows form as
luminance. What differs in hue alone, as hair and skin of a doll do, becomes luminance as well.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.imaging.color import luma_weights
from stylesplat.imaging.similarity import blur, blurs, smooth
from stylesplat.rendering.render import render
from stylesplat.rendering.surface import front_depth, points_at
from stylesplat.rendering.weights import COVERED, colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import SH_C0, Splats
from stylesplat.stylization.colors import PAINT_HIDDEN, PAINT_STRIDE
from stylesplat.stylization.views import ObjectBox, PaintView, box_cameras

BAND_DEVIATIONS = (0.004, 0.015, 0.05)  # of blurs whose differences are bands, in lengths
ENERGY_DEVIATION = 0.03  # of the blur that averages a band's energy, in lengths
SALIENT = 0.3  # times the median energy: less is pattern
# Contrast is seen relative to the luminance around it (Weber): its deviation, in lengths, the
# luminance that is added, at which details count in full, and the factors at most
ADAPTATION, GLARE, MIDDLE_GREY, WEBER = 0.05, 0.1, 0.5, (0.5, 4.0)
SURVEY_LENGTH = 96.0  # pixels of the object's longer side where bands are compared
FORM_SURVEY_VIEWS = 8  # with 6 rare sides get too much form
# Deviation of a band's energy over the object, of its mean: of pattern, and what counts in full.
# The demo's vase and teapot have .67 to .75, a doll .89, fox and a face 1.1 to 1.5.
EVEN, UNEVEN = 0.75, 0.88
# Of detail in two values less is pattern: dots and stripes all over have .02 to .29, a sign .7
EVEN_OF_TWO = 0.5
# Bimodality of what has many values, and of two. The vase has .57 in most places and .75 in one of
# twenty, fox .47, a sign's letters .85 to .95, .8 where pixels blur them.
TWO_FROM, TWO = 0.75, 0.88
FORM_CHROMA = 0.5  # luminance that one unit of an object's main hue contrast becomes
FORM_TINY = 1e-6  # energy of a band that the object hardly has
FORM_NEAR = 0.04  # deviation of the window of a local correlation, in lengths
FORM_FAINT = 0.01  # of 1: detail of less contrast is not seen
FORM_ROUNDS = 6  # of `form_relief`: with 1 eyes are blurred, 12 show no more
RARE = 0.05  # share of an object: less form than that counts less
POOLED_DEVIATION = 1.0  # pixels of the finest band's blur at least, in a pooled view


# Luminance of the shading by a light at the camera, which draws petals and folds that colours do
# not show, in bands; the contrast that counts by half; the blur of depths, in lengths
HEADLIGHT, HEADLIGHT_HALF, HEADLIGHT_BLUR = 0.2, 0.08, 0.004


class FormSurvey(NamedTuple):
    """The detail of an object in all views, by bands of size."""

    energies: Sequence[float]
    """The median of the local energy: what stands out has more."""
    variations: Sequence[float]
    """The deviation of the energy of plain luminance, of its mean: small if the object has its
    detail everywhere."""
    hue: Float[Tensor, " 3"]
    """The object's main contrast besides luminance; see `main_hue`."""

    @property
    def unevenness(self) -> float:
        """0 for an object with a pattern all over, 1 for one with parts."""
        return min(max((max(self.variations) - EVEN) / (UNEVEN - EVEN), 0.0), 1.0)

    def as_parts(self) -> "FormSurvey":
        """The survey with all detail counted as form, a pattern too."""
        return self._replace(variations=[max(each, UNEVEN) for each in self.variations])


class FormTarget(NamedTuple):
    """The form that one view shows, by bands of sizes."""

    detail: Float[Tensor, "B H W"]
    """Luminance that stands out, over `MIDDLE_GREY`, relative to what is around."""
    weight: Float[Tensor, "B H W"]
    """How much each pixel counts; the sum of a band is at most 1."""
    energy: Float[Tensor, "B H W"]
    """The detail's square, blurred."""
    mask: Float[Tensor, "H W"]
    """1 where the view shows the object, 0 elsewhere."""
    inside: Float[Tensor, "L H W"]
    """See `blurred_mask`."""


def survey_detail(
    splats: Splats, mask: Bool[Tensor, " N"], boxes: Sequence[ObjectBox]
) -> FormSurvey:
    """The detail of an object, whatever size it is painted in."""
    cameras = box_cameras(boxes, SURVEY_LENGTH, FORM_SURVEY_VIEWS, margin=0)
    pairs = [colors_and_coverage(splats, camera, mask) for camera in cameras]
    images, covered = zip(*pairs, strict=True)
    return measure_detail(images, [each[..., 0] > COVERED for each in covered], SURVEY_LENGTH)


@torch.no_grad()
def measure_detail(
    images: Sequence[Float[Tensor, "_ _ 3"]], masks: Sequence[Bool[Tensor, "_ _"]], length: float
) -> FormSurvey:
    """Measure an object's detail in views of the whole unpainted object, so many pixels long."""
    plain, relative = [], []
    hue = main_hue(torch.cat([i[mask] for i, mask in zip(images, masks, strict=True)]))
    for image, mask in zip(images, masks, strict=True):
        bands = object_detail(image, mask, length, hue)
        for energies, each in (plain, bands), (relative, bands * weber_gain(image, mask, length)):
            energies.append(smooth(each.square(), mask, ENERGY_DEVIATION * length)[:, mask])
    variations = [
        float(energy.std() / (energy.mean() + FORM_TINY)) for energy in torch.cat(plain, dim=1)
    ]
    medians = [float(energy.median()) for energy in torch.cat(relative, dim=1)]
    return FormSurvey(medians, variations, hue)


def weber_gain(
    image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"], length: float
) -> Float[Tensor, "H W"]:
    """By how much detail is seen more than in front of middle grey: in the dark more."""
    luma = image @ luma_weights(image.device, image.dtype)
    around = smooth(luma, mask, ADAPTATION * length)
    return (MIDDLE_GREY / (around + GLARE)).clamp(*WEBER)


def main_hue(colors: Float[Tensor, "P 3"]) -> Float[Tensor, " 3"]:
    """Weights of red, green and blue: the main direction of what luminance leaves of colours."""
    luma = luma_weights(colors.device, colors.dtype)
    hues = colors - (colors @ luma)[:, None]
    main = torch.linalg.eigh(hues.T.cov(correction=0)).eigenvectors[:, -1]
    return main - main.sum() * luma


def object_detail(
    image: Float[Tensor, "H W 3"],
    mask: Bool[Tensor, "H W"],
    length: float,
    hue: Float[Tensor, " 3"],
) -> Float[Tensor, "B H W"]:
    """The detail of an unpainted object, by bands, as luminance, to whose contrast hues add."""
    near = FORM_NEAR * length
    weights = torch.stack([luma_weights(image.device, image.dtype), FORM_CHROMA * hue.to(image)])
    grey = torch.einsum("hwc,dc->dhw", image, weights)
    luma, chroma = detail_bands(grey, mask, length).unbind(dim=1)
    together = blur(luma * chroma, near) + _faint_energy(near)
    return luma + together.sign() * chroma


@dataclass(frozen=True, eq=False)
class PooledMask:
    """An object's pixels in a view as small as shows its form as well, which takes less time."""

    mask: Bool[Tensor, "h w"]
    length: float
    """The object's, in these pixels."""
    side: int
    """Pixels of a view along a square that becomes one pixel."""
    own: Float[Tensor, "1 H W"]
    """1 where the view shows the object, 0 elsewhere."""
    covered: Float[Tensor, "1 h w"]
    """The mean of that over each square."""

    @classmethod
    def of(cls, mask: Bool[Tensor, "H W"], length: float) -> "PooledMask":
        """The mask of a view of an object that is so many pixels long there."""
        side = max(1, int(BAND_DEVIATIONS[0] * length / POOLED_DEVIATION))
        own = mask[None].float()
        covered = F.avg_pool2d(own, side)
        return cls(covered[0] > 0.5, length / side, side, own, covered.clamp(min=1e-3))

    def average(self, image: Float[Tensor, "H W 3"]) -> Float[Tensor, "h w 3"]:
        """The means of the object's pixels alone over the squares."""
        if self.side == 1:
            return image
        pooled = F.avg_pool2d(image.permute(2, 0, 1) * self.own, self.side) / self.covered
        return pooled.permute(1, 2, 0)


@torch.no_grad()
def measure_form(
    image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"], length: float, survey: FormSurvey
) -> FormTarget:
    """Find the form in a view of the unpainted object, which is so many pixels long."""
    bands = weber_gain(image, mask, length) * object_detail(image, mask, length, survey.hue)
    luma = image @ luma_weights(image.device, image.dtype)
    bimodal = bimodality(luma, mask, BAND_DEVIATIONS[-1] * length)
    two = ((bimodal - TWO_FROM) / (TWO - TWO_FROM)).clamp(0, 1)
    even = EVEN + two * (EVEN_OF_TWO - EVEN)
    energies = smooth(bands.square(), mask, ENERGY_DEVIATION * length)
    # an object that is even in one band of sizes alone has no pattern all over
    share = ((max(survey.variations) - even) / (UNEVEN - EVEN)).clamp(0, 1)
    pattern = (1 - two) * SALIENT
    least = torch.stack([pattern * typical for typical in survey.energies]) + FORM_FAINT**2
    weight = (1 - least / energies.maximum(least)) * mask
    areas = torch.stack([each.sum() for each in weight + RARE * mask])
    detail = share * weight * bands
    around = blur(detail.square(), FORM_NEAR * length)
    own = mask.to(image)
    weight = share * weight / areas[:, None, None]
    return FormTarget(detail, weight, around, own, blurred_mask(own, length))


def bimodality(
    grey: Float[Tensor, "H W"], mask: Bool[Tensor, "H W"], deviation: float
) -> Float[Tensor, "H W"]:
    """Sarle's coefficient of bimodality around each place: 1 for two values, 1/3 for a normal
    distribution, nearly 0 for what is faint."""
    powers = torch.stack([grey.double() ** n for n in (1, 2, 3, 4)])
    mean, square, cube, fourth = smooth(powers, mask, deviation)
    variance = (square - mean**2).clamp(min=0)
    third = cube - 3 * mean * square + 2 * mean**3
    fourth = fourth - 4 * mean * cube + 6 * mean**2 * square - 3 * mean**4
    return ((third**2 + variance**3) / (fourth * variance + FORM_FAINT**6)).to(grey)


def form_distance(
    image: Float[Tensor, "H W 3"], length: float, form: FormTarget
) -> Float[Tensor, ""]:
    """1 minus the local correlation of a painted view's luminance with the form, over bands.

    Every place that stands out counts by how much it does, whatever its contrast: an eye in the
    shade as much as one in the light. All bands are computed at once: painting asks for this in
    every step, and on a GPU each operation is a kernel to start.
    """
    near = FORM_NEAR * length
    grey = image @ luma_weights(image.device, image.dtype)
    bands = _bands_inside(grey * form.mask, form.inside, length)
    energy, shared = blur(torch.stack([bands.square(), bands * form.detail]), near)
    correlation = shared / (energy * form.energy + _faint_energy(near) ** 2).sqrt()
    return (form.weight * (1 - correlation)).sum()


def _faint_energy(near: float) -> float:
    """What a blur of this deviation gives of faint detail: it has the sum of its Gaussian."""
    return 2 * math.pi * (near * FORM_FAINT) ** 2


@torch.no_grad()
def shape_detail(
    splats: Splats, camera: Cameras, mask: Bool[Tensor, "H W"], length: float
) -> list[Float[Tensor, "H W"]]:
    """What a light at the camera shows of the shape of an object, by bands, as luminance."""
    depths, _ = front_depth(splats, camera)
    depths = smooth(depths, mask, HEADLIGHT_BLUR * length)
    points = points_at(depths, camera)
    lit = facing_share(points, mask, camera.positions.to(points))
    bands = detail_bands(lit, mask, length)
    energies = smooth(bands.square(), mask, ENERGY_DEVIATION * length)
    return [*(HEADLIGHT * energies / (energies + HEADLIGHT_HALF**2) * bands)]


def facing_share(
    points: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"], origin: Float[Tensor, "1 3"]
) -> Float[Tensor, "H W"]:
    """The cosine between rays to a camera and normals, from neighbours within a mask alone."""

    def slopes(points: Float[Tensor, "A B 3"], mask: Bool[Tensor, "A B"]) -> Float[Tensor, "A B 3"]:
        steps = points.diff(dim=0) * (mask[1:] & mask[:-1])[..., None]
        return F.pad(steps, (0, 0, 0, 0, 0, 1)) + F.pad(steps, (0, 0, 0, 0, 1, 0))

    down, along = slopes(points, mask), slopes(points.transpose(0, 1), mask.T).transpose(0, 1)
    normals = F.normalize(torch.linalg.cross(along, down), dim=-1)
    return (normals * F.normalize(origin - points, dim=-1)).sum(dim=-1).abs() * mask


@torch.no_grad()
def form_detail(
    before: Splats,
    camera: Cameras,
    mask: Bool[Tensor, "H W"],
    length: float,
    survey: FormSurvey,
) -> list[Float[Tensor, "H W"]]:
    """The form of an unpainted object in a view, and what its shape adds, by bands, as luminance.

    The view shows it so many pixels long, the mask where.
    """
    details = [*measure_form(render(before, camera)[0], mask, length, survey).detail]
    if survey.unevenness > 0:
        shape = shape_detail(before, camera, mask, length)
        details = [d + survey.unevenness * s for d, s in zip(details, shape, strict=True)]
    return details


@torch.no_grad()
def form_relief(
    before: Splats,
    views: Sequence[PaintView],
    count: int,
    length: float,
    survey: FormSurvey,
) -> Float[Tensor, "P 2"]:
    """The form of an object as luminance that each of its points adds, by bands, in -1..1.

    Adding it to painted colours, or taking it away, changes the form in closed form. It is the
    luminance whose renders are nearest to the form of the scene before in all views (simultaneous
    algebraic reconstruction, Gilbert 1972). They show the whole object, so many pixels long.
    """
    relief, weights = before.means.new_zeros(count, 2), before.means.new_zeros(count, 1)
    targets = []
    for view in views:
        own = view.pixels.to(relief)
        details = form_detail(before, view.camera, view.pixels, length, survey)
        target = torch.stack([*details, own], dim=2)
        weights += view.backproject(target)[:, 2:]
        grey = view.render(F.pad(relief, (0, 1)))
        targets.append((view, (target + grey)[..., :2], own[..., None]))
    for _ in range(FORM_ROUNDS):
        missing = torch.zeros_like(relief)
        for view, target, own in targets:
            error = (target - view.render(F.pad(relief / SH_C0, (0, 1)))[..., :2]) * own
            missing += view.backproject(F.pad(error, (0, 1)))[:, :2]
        relief = relief + PAINT_STRIDE * missing / weights.clamp(min=PAINT_HIDDEN)
        relief = torch.where(weights > PAINT_HIDDEN, relief, 0).clamp(-1, 1)
    return relief


def detail_bands(
    grey: Float[Tensor, "*B H W"], mask: Bool[Tensor, "H W"], length: float
) -> Float[Tensor, "_ *B H W"]:
    """Grey images between each two of `BAND_DEVIATIONS`, inside the mask alone; 0 elsewhere."""
    own = mask.to(grey)
    inside = blurred_mask(own, length)
    return _bands_inside(grey * own, inside.view(-1, *[1] * (grey.ndim - 2), *own.shape), length)


def blurred_mask(mask: Float[Tensor, "H W"], length: float) -> Float[Tensor, "L H W"]:
    """How much of each blur around a pixel is inside a mask; infinite outside, where means are 0.

    The blurs are those of `BAND_DEVIATIONS`, the widest first.
    """
    covered = blurs(mask, _band_pixels(length)).clamp(min=1e-3)
    return covered.where(mask > 0, math.inf)


def _bands_inside(
    grey: Float[Tensor, "*B H W"], inside: Float[Tensor, "*_ H W"], length: float
) -> Float[Tensor, "_ *B H W"]:
    """See `detail_bands`; grey images are 0 outside the mask."""
    coarse, middle, fine = (blurs(grey, _band_pixels(length)) / inside).unbind()
    return torch.stack([fine - middle, middle - coarse])


def _band_pixels(length: float) -> tuple[float, ...]:
    return tuple(deviation * length for deviation in reversed(BAND_DEVIATIONS))
