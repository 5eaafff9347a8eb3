"""Colours of an object: initial ones, transfer, the palette; recolouring in closed form."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.metrics.lab import LUMA, distinct, lab_from_rgb, nearest_colors, thinned
from stylesplat.rendering.render import render
from stylesplat.rendering.shares import COVERED
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import SH_C0, Splats, map_bands, rgb_from_sh0, sh0_from_rgb
from stylesplat.stylization.config import RecolorConfig, parse_color
from stylesplat.stylization.style_image import read_style, resize
from stylesplat.stylization.views import ObjectView, total_weights, with_fixed_bands

NOISE = 1e-6  # variance added to both sides, so that flat colours can be inverted
VARIATION = 0.05  # deviation of the colours that `vary_colors` adds, of 1
WAVELENGTH = 0.12  # of its pattern, in sizes of the object
WAVES = 48  # that it is made of
PATTERN = 0.08  # deviation, in lengths of the object, of the blur that removes its pattern
SHADING = 0.7  # of the object's light to keep: with all of it the dark side shows nothing else
LEAST_DEVIATION = 0.5  # pixels of a blur's deviation; less blurs nothing
HIDDEN = 1e-3  # pixels that a Gaussian contributes to all views: fewer tell no colour
SHADE = 5.0  # of Lab: colours in one cube of this size are one
NEAR = 6.0  # of Lab: a colour this near to the palette may stay
LEVELS = 24  # of red, green and blue in the table of nearest colours
ROUNDS = 4  # of `project_to_palette`; further ones hardly change anything
STRIDE = 1.5  # of its steps: more than 1 is sooner there, from 2 on it would diverge
DARKEST = 1e-4  # of 1: above the clamp at black, which has no gradient, far below a level
FAINT = 0.05  # of the median weight: Gaussians that show less move accordingly less
# W3C, Filter Effects 1, hueRotate: what the sine of the angle is multiplied by
HUE_SINE = ((-0.213, -0.715, 0.928), (0.143, 0.140, -0.283), (-0.787, 0.715, 0.072))
WARMTH = 0.25  # logarithm of red's factor, and of 1 / blue's, at temperature 1
STEEPEST = 2.0  # times the shading of a dark object: more shows its noise
DARK = 1e-3  # luma to divide by
VIEWS, LONGER_SIDE = 4, 160  # of renders that show the colours of an object
PICTURE_SIDE = 256.0  # pixels of the picture whose colours are matched


@torch.no_grad()
def transfer_colors(
    splats: Splats,
    mask: Bool[Tensor, " N"],
    style: Float[Tensor, "P 3"],
    views: Sequence[ObjectView],
) -> Splats:
    """Map an object's colours so that its pixels have the style's mean and covariance."""
    return map_colors(splats, mask, color_map(object_colors(splats, views), style))


@torch.no_grad()
def object_colors(splats: Splats, views: Sequence[ObjectView]) -> Float[Tensor, "P 3"]:
    """The colours of the object's pixels in all views."""
    return torch.cat([view.render(splats)[view.pixels] for view in views])


@torch.no_grad()
def vary_colors(splats: Splats, mask: Bool[Tensor, " N"], *, seed: int) -> Splats:
    """Add smooth patches of other hues, of the same luminance: flat areas vary as paintings do."""
    generator = torch.Generator().manual_seed(seed)
    directions = F.normalize(torch.randn(WAVES, 3, generator=generator), dim=1)
    phases = 2 * math.pi * torch.rand(WAVES, generator=generator)
    mixture = torch.randn(WAVES, 3, generator=generator) * math.sqrt(2 / WAVES)
    means = splats.means[mask]
    size = (means.quantile(0.95, dim=0) - means.quantile(0.05, dim=0)).norm()
    waves = directions.to(means) * (2 * math.pi / (WAVELENGTH * size))
    pattern = torch.cos(means @ waves.T + phases.to(means)) @ mixture.to(means)
    pattern = pattern - (pattern @ pattern.new_tensor(LUMA))[:, None]
    rows = mask.nonzero()[:, 0]
    varied = splats.sh0[rows] + VARIATION / SH_C0 * pattern[:, None]
    return splats.with_rows(rows, {"sh0": varied})


def color_map(source: Float[Tensor, "P 3"], target: Float[Tensor, "Q 3"]) -> Float[Tensor, "3 4"]:
    """The affine map that takes one set of colours to another's mean and covariance.

    Of all such maps it moves the colours least (Pitie & Kokaram 2007, "The linear
    Monge-Kantorovitch linear colour mapping"). The fourth column is the offset.
    """
    noise = NOISE * torch.eye(3).to(source)
    root = _matrix_sqrt(source.T.cov(correction=0) + noise)
    inverse = torch.linalg.inv(root)
    wanted = target.T.cov(correction=0) + noise
    matrix = inverse @ _matrix_sqrt(root @ wanted @ root) @ inverse
    offset = target.mean(dim=0) - matrix @ source.mean(dim=0)
    return torch.cat([matrix, offset[:, None]], dim=1)


def mapped(colors: Float[Tensor, "*P 3"], color_map: Float[Tensor, "3 4"]) -> Float[Tensor, "*P 3"]:
    """Colours after an affine map."""
    return colors @ color_map[:, :3].T + color_map[:, 3]


def map_colors(splats: Splats, mask: Bool[Tensor, " N"], color_map: Float[Tensor, "3 4"]) -> Splats:
    """Apply an affine map to the colours of some Gaussians, in all bands."""
    rows = mask.nonzero()[:, 0]
    sh0, shN = map_bands(splats.sh0[rows], splats.shN[rows], color_map)
    return splats.with_rows(rows, {"sh0": sh0, "shN": shN})


def _matrix_sqrt(matrix: Tensor) -> Tensor:
    values, vectors = torch.linalg.eigh(matrix)
    return vectors @ (values.clamp(min=0).sqrt()[:, None] * vectors.T)


@torch.no_grad()
def remove_pattern(
    splats: Splats,
    mask: Bool[Tensor, " N"],
    views: Sequence[ObjectView],
    length: float,
    share: float,
) -> Splats:
    """Remove a share of the object's own pattern, all that is smaller than `PATTERN` of it.

    With it goes a part of the shading, so that strokes and form have room between the style's
    darkest colour and its brightest. The views show the whole object, so many pixels long.
    """
    if share == 0:
        return splats
    blurred = blur_colors(splats, mask, views, PATTERN * length).sh0[mask]
    flat = blurred.mean(dim=0).lerp(blurred, SHADING)
    rows = mask.nonzero()[:, 0]
    return splats.with_rows(rows, {"sh0": splats.sh0[rows].lerp(flat, share)})


def add_luminance(splats: Splats, luminance: Float[Tensor, " N"]) -> Splats:
    return replace(splats, sh0=splats.sh0 + luminance[:, None, None] / SH_C0)


@torch.no_grad()
def blur_colors(
    splats: Splats, mask: Bool[Tensor, " N"], views: Sequence[ObjectView], deviation: float = 0.0
) -> Splats:
    """Give Gaussians the mean colour of the pixels that they contribute to.

    Renders as small as the strokes are large match nothing finer than their pixels: there Gaussians
    differ by chance. The deviation is that of a Gaussian blur of the renders, in pixels.
    """
    matte = replace(splats, shN=splats.shN.masked_fill(mask[:, None, None], 0))
    total, weights = torch.zeros_like(splats.sh0), torch.zeros_like(splats.sh0)
    for view in views:
        image, own = view.render(matte), view.pixels[..., None]
        blurred = smooth(image.permute(2, 0, 1), view.pixels, deviation).permute(1, 2, 0)
        total += view.backproject(matte, blurred)
        weights += view.backproject(matte, own.expand_as(image).to(image))
    mean = (total / weights.clamp(min=HIDDEN) - 0.5) / SH_C0
    visible = mask[:, None, None] & (weights > HIDDEN)
    return replace(splats, sh0=torch.where(visible, mean, splats.sh0))


def smooth(
    values: Float[Tensor, "*B H W"], mask: Bool[Tensor, "H W"], deviation: float
) -> Float[Tensor, "*B H W"]:
    """A Gaussian blur of values inside a mask, to which what lies outside adds nothing."""
    if deviation < LEAST_DEVIATION:
        return values * mask
    inside = mask.to(values)
    return inside * blur(values * inside, deviation) / blur(inside, deviation).clamp(min=1e-3)


def blur(values: Float[Tensor, "*B H W"], deviation: float) -> Float[Tensor, "*B H W"]:
    """A Gaussian blur with zeros around, of no particular sum: two products of matrices."""
    height, width = values.shape[-2:]
    rows, columns = (
        blur_matrix(size, deviation, values.device).to(values) for size in (height, width)
    )
    return rows @ values @ columns


@lru_cache(maxsize=32)
def blur_matrix(size: int, deviation: float, device: torch.device) -> Float[Tensor, "S S"]:
    """The weight of each place along an axis in the blur of each other."""
    places = torch.arange(size, dtype=torch.float32)
    return (-((places[:, None] - places) / deviation).square() / 2).exp().to(device)


@dataclass(frozen=True)
class Palette:
    """The colours of a style, and the nearest of them to any colour."""

    table: Float[Tensor, "_ 3"]
    """The nearest colour in 0..1, by red, green and blue in `LEVELS` levels, blue fastest."""
    shares: Float[Tensor, " _"]
    """The share of the way there that ends at distance `NEAR`; 0 for nearer colours."""

    def offset(self, colors: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 3"]:
        """From colours in 0..1 to where the palette is near; without gradients."""
        colors = colors.detach()
        red, green, blue = (colors.clamp(0, 1) * (LEVELS - 1)).round().long().unbind(-1)
        rows = ((red * LEVELS + green) * LEVELS + blue).flatten()
        nearest = self.table.index_select(0, rows).view(colors.shape)
        return (nearest - colors) * self.shares.index_select(0, rows).view(*colors.shape[:-1], 1)

    def distance(
        self, image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"]
    ) -> Float[Tensor, ""]:
        """The mean squared offset of some pixels, which gradients shorten."""
        offset = self.offset(image) * mask[..., None]
        goal = torch.where(offset != 0, image.detach() + offset, image)
        return (image - goal).square().sum() / mask.sum()


@torch.no_grad()
def build_palette(style: Float[Tensor, "Q 3"]) -> Palette:
    """Prepare the colours of a style, in 0..1."""
    palette = distinct(thinned(style), SHADE)  # rarer colours are no aim
    axis = torch.linspace(0, 1, LEVELS).to(style)
    every, shades = lab_from_rgb(torch.cartesian_prod(axis, axis, axis)), lab_from_rgb(palette)
    nearest = nearest_colors(every, shades)
    away = (every - shades[nearest]).norm(dim=1)
    return Palette(palette[nearest], (1 - NEAR / away).clamp(min=0))


def project_to_palette(
    splats: Splats,
    mask: Bool[Tensor, " N"],
    views: Sequence[ObjectView],
    palette: Palette,
    beneath: Bool[Tensor, " N"],
) -> Splats:
    """Move an object's colours until its pixels are near the palette.

    Of Gaussians beneath the strokes the colours themselves are near it: other views may show them
    bare. Each round backprojects every pixel's offset to the Gaussians by their weights, and
    averages (simultaneous algebraic reconstruction, Gilbert 1972).
    """
    views = with_fixed_bands(views, splats)
    weights = total_weights(views, splats, mask)
    weights = weights + FAINT * weights[weights > 0].median()
    rows = mask.nonzero()[:, 0]
    colors = splats.sh0[rows, 0] * SH_C0 + 0.5
    brightest = colors.clamp(min=1)  # Gaussians that show in part need colours beyond white
    for _ in range(ROUNDS):
        # below black nothing shows, and nothing can be asked for
        colors = colors.clamp(min=DARKEST)
        sh0 = splats.sh0.index_copy(0, rows, sh0_from_rgb(colors)[:, None]).requires_grad_()
        with torch.enable_grad():
            for view in views:
                image = view.render(replace(splats, sh0=sh0))
                (image * palette.offset(image) * view.pixels[..., None]).sum().backward()
        assert sh0.grad is not None
        offsets = sh0.grad[rows, 0] / SH_C0 / weights[:, None]
        colors = (colors + STRIDE * offsets).minimum(brightest)
        colors = torch.where(beneath[rows, None], colors + palette.offset(colors), colors)
    return splats.with_rows(rows, {"sh0": sh0_from_rgb(colors.clamp(min=0))[:, None]})


@torch.no_grad()
def recolor_map(
    config: RecolorConfig, splats: Splats, mask: Bool[Tensor, " N"], cameras: Cameras
) -> Float[Tensor, "3 4"]:
    """The affine map of a recolouring; matching and tinting depend on the colours of the object."""
    luma, one = torch.tensor(LUMA), torch.eye(3)
    grey = torch.ones(3, 1) * luma  # [3, 3], shows the luma of a colour
    steps = []
    if config.match is not None or config.tint is not None:
        own = _shown_colors(splats, mask, cameras)
        if config.match is not None:
            picture = resize(read_style(config.match), PICTURE_SIDE)
            steps.append(color_map(own, picture.reshape(-1, 3)))
            own = mapped(own, steps[0])
        if config.tint is not None:
            steps.append(_tint(torch.tensor(parse_color(config.tint)), own.mean(dim=0)))
    sine, cosine = math.sin(math.radians(config.hue)), math.cos(math.radians(config.hue))
    gains = torch.tensor([WARMTH, 0.0, -WARMTH]).mul(config.temperature).exp()
    matrices = [
        grey + cosine * (one - grey) + sine * torch.tensor(HUE_SINE),
        grey + config.saturation * (one - grey),
        torch.diag(gains / (gains @ luma)),
        config.brightness * one,
    ]
    steps += [F.pad(matrix, (0, 1)) for matrix in matrices]
    steps.append(F.pad(config.contrast * one, (0, 1), value=(1 - config.contrast) / 2))
    last_row = torch.tensor([[0.0, 0.0, 0.0, 1.0]])
    return reduce(lambda a, b: b @ torch.cat([a, last_row]), steps)


def _tint(color: Float[Tensor, " 3"], mean: Float[Tensor, " 3"]) -> Float[Tensor, "3 4"]:
    """The map that takes the mean to a colour, and what is lighter or darker to shades of it."""
    luma = torch.tensor(LUMA)
    shade = color / (color @ luma).clamp(min=DARK)  # of luma 1
    steepness = ((color @ luma) / (mean @ luma).clamp(min=DARK)).clamp(max=STEEPEST)
    matrix = steepness * shade[:, None] * luma
    return torch.cat([matrix, (color - matrix @ mean)[:, None]], dim=1)


def _shown_colors(
    splats: Splats, mask: Bool[Tensor, " N"], cameras: Cameras
) -> Float[Tensor, "P 3"]:
    """The colours of an object alone in a few views; where none shows it, its Gaussians'."""
    own, shown = splats[mask.nonzero()[:, 0]], []
    for row in evenly(range(len(cameras)), VIEWS):
        image, alphas = render(own, cameras[row].at_most(LONGER_SIDE))
        shown.append((image / alphas)[alphas[..., 0] > COVERED])
    colors = torch.cat(shown)
    return (colors if len(colors) else rgb_from_sh0(own.sh0[:, 0])).clamp(0, 1)
