"""Colours of an object: initial ones of paint, transfer, blurs, palettes; recolouring."""

import math
from collections.abc import Iterable, Sequence
from functools import reduce

import torch
from jaxtyping import Bool, Float
from scipy.cluster.vq import kmeans2
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.imaging.color import (
    TONE_LEVELS,
    Palette,
    color_map,
    lab_from_rgb,
    nearest_colors,
    thinned,
    tone_curve,
    transform_rgb,
)
from stylesplat.imaging.similarity import blurs, smooth
from stylesplat.rendering.render import render
from stylesplat.rendering.weights import COVERED
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.palette import tone_curves
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import LUMA, SH_C0, Splats, map_bands, rgb_from_sh0, sh0_from_rgb
from stylesplat.stylization.config import RecolorConfig, parse_color, parse_swap
from stylesplat.stylization.style import all_colors
from stylesplat.stylization.views import PaintView, total_weights

VARIATION = 0.05  # deviation of the colours that `add_hue_noise` adds, of 1
WAVELENGTH = 0.12  # of its pattern, in sizes of the object
WAVES = 48  # that it is made of
PATTERN = 0.08  # deviation, in lengths of the object, of the blur that removes its pattern
SHADING = 0.7  # of the object's light to keep: with all of it the dark side shows nothing else
# Of an object with parts: deviation of the windows, in lengths, in which one is told from another
# by more than this contrast
PARTS_WINDOW, PARTS = 0.04, 0.12
# Pixels: deviations of the blurs that tell detail of hues by its size
HUE_BANDS = 0.7, 1.4, 2.8
HUE_RIM = 3  # pixels from an outline, where an image has hues of what is behind
HUE_ROUNDS = 4  # of `limit_hue_detail`, which leave a third of the excess at .7 to 1.4 pixels
PAINT_HIDDEN = 1e-3  # pixels that a Gaussian contributes to all views: fewer tell no colour
PAINT_ROUNDS = 4  # of `project_to_palette`; further ones hardly change anything
PAINT_STRIDE = 1.5  # of its steps: more than 1 is sooner there, from 2 on it would diverge
DARKEST = 1e-4  # of 1: above the clamp at black, which has no gradient, far below a level
PAINT_FAINT = 0.05  # of the median weight: Gaussians that show less move accordingly less


Colors = Float[Tensor, "P 3"]
"""Of the Gaussians or texels of an object, as coefficients of the constant band."""


@torch.no_grad()
def transfer_colors(
    colors: Colors, style: Float[Tensor, "Q 3"], views: Sequence[PaintView]
) -> Colors:
    """Map an object's colours so that its pixels have the style's mean, covariance and tones."""
    change = color_map(object_colors(colors, views), style)
    mapped = map_bands(colors[:, None], colors.new_zeros(len(colors), 0, 3), change)[0][:, 0]
    luma = style.new_tensor(LUMA)
    curve = tone_curve(object_colors(mapped, views) @ luma, style @ luma)
    rgb = rgb_from_sh0(mapped)
    return sh0_from_rgb(with_luminance(rgb, curve(rgb @ luma.to(rgb))))


@torch.no_grad()
def transfer_two_bands(
    colors: Colors,
    pictures: Sequence[Float[Tensor, "_ _ 3"]],
    views: Sequence[PaintView],
    deviation: float,
    pictures_deviation: float,
) -> Colors:
    """Map what a blur leaves as `transfer_colors`, and bring the contrast of the rest to pictures'.

    A painting's darkest colour may be that of thin lines: matched as a whole, a fox's dark side
    became flat black after a woodcut (8 % of its pixels; 2.5 % of the woodcut; in bands 1 %). The
    luminance of detail gets no less contrast than it has, as form is in it, and no Gaussian gets
    darker or brighter than all but .5 % of the pictures.

    Args:
        colors: Of the object.
        pictures: Of the style.
        views: Of the whole object.
        deviation: Of the blur, in pixels of the views.
        pictures_deviation: The same in pixels of the pictures.
    """
    shapes = [_blurred(each, pictures_deviation) for each in pictures]
    broad = blur_colors(colors, views, deviation)
    found = _contrasts(object_colors(colors, views) - object_colors(broad, views))
    wanted = _contrasts(all_colors([a - b for a, b in zip(pictures, shapes, strict=True)]))
    gains = (wanted / found.clamp(min=PAINT_DARK)).clamp(max=MOST_CONTRAST)
    luma = colors.new_tensor(LUMA)
    detail = colors - broad
    light = (detail @ luma)[:, None]
    mapped = transfer_colors(broad, all_colors(shapes), views)
    rgb = rgb_from_sh0(mapped + gains[0].clamp(min=1) * light + gains[1] * (detail - light))
    tones = thinned(all_colors(pictures) @ luma.to(pictures[0]))
    ends = tones.quantile(tones.new_tensor([TONE_LEVELS[0], TONE_LEVELS[-1]])).to(rgb)
    return sh0_from_rgb(with_luminance(rgb, (rgb @ luma).clamp(*ends)))


def _contrasts(detail: Float[Tensor, "Q 3"]) -> Float[Tensor, "2"]:
    """The deviations of detail as a whole, and of its hues."""
    hues = detail - (detail @ detail.new_tensor(LUMA))[:, None]
    return torch.stack([each.square().mean().sqrt() for each in (detail, hues)])


def _blurred(picture: Float[Tensor, "H W 3"], deviation: float) -> Float[Tensor, "H W 3"]:
    everywhere = torch.ones_like(picture[..., 0], dtype=torch.bool)
    return smooth(picture.permute(2, 0, 1), everywhere, deviation).permute(1, 2, 0)


def with_luminance(
    rgb: Float[Tensor, "P 3"], luminance: Float[Tensor, " P"]
) -> Float[Tensor, "P 3"]:
    """Colours of another luminance: what gets darker keeps its hue, what gets lighter gets grey."""
    before = rgb @ rgb.new_tensor(LUMA)
    darker = rgb * (luminance / before.clamp(min=PAINT_DARK))[:, None]
    lighter = rgb + (luminance - before)[:, None]
    return torch.where((luminance < before)[:, None], darker, lighter)


@torch.no_grad()
def object_colors(colors: Colors, views: Sequence[PaintView]) -> Float[Tensor, "Q 3"]:
    """The colours of the object's pixels in all views, in 0..1."""
    return torch.cat([view.render(colors)[view.pixels] for view in views])


@torch.no_grad()
def add_hue_noise(colors: Colors, means: Float[Tensor, "P 3"], *, seed: int) -> Colors:
    """Add smooth patches of other hues, of the same luminance: flat areas vary as paintings do."""
    generator = torch.Generator().manual_seed(seed)
    directions = F.normalize(torch.randn(WAVES, 3, generator=generator), dim=1)
    phases = 2 * math.pi * torch.rand(WAVES, generator=generator)
    mixture = torch.randn(WAVES, 3, generator=generator) * math.sqrt(2 / WAVES)
    size = (means.quantile(0.95, dim=0) - means.quantile(0.05, dim=0)).norm()
    waves = directions.to(means) * (2 * math.pi / (WAVELENGTH * size))
    pattern = torch.cos(means @ waves.T + phases.to(means)) @ mixture.to(means)
    pattern = pattern - (pattern @ pattern.new_tensor(LUMA))[:, None]
    return colors + VARIATION / SH_C0 * pattern


@torch.no_grad()
def low_pass_colors(
    colors: Colors,
    views: Sequence[PaintView],
    length: float,
    share: float,
    unevenness: float = 0.0,
) -> Colors:
    """Remove a share of the object's own pattern, all that is smaller than `PATTERN` of it.

    With it goes a part of the shading, so that strokes and form have room between the style's
    darkest colour and its brightest. An uneven object has parts: these keep their colours, as far
    as their contrast is more than `PARTS`. The views show the whole object, so many pixels long.
    """
    if share == 0:
        return colors
    blurred = blur_colors(colors, views, PATTERN * length)
    plain = blurred.mean(dim=0).lerp(blurred, SHADING)
    if unevenness > 0:
        parts = blur_colors(colors, views, PARTS_WINDOW * length, contrast=PARTS)
        plain = plain.lerp(parts, unevenness)
    return colors.lerp(plain, share)


def add_luminance(colors: Colors, luminance: Float[Tensor, " P"]) -> Colors:
    return colors + luminance[:, None] / SH_C0


@torch.no_grad()
def blur_colors(
    colors: Colors,
    views: Sequence[PaintView],
    deviation: float = 0.0,
    contrast: float | None = None,
) -> Colors:
    """Give Gaussians the mean colour of the pixels that they contribute to.

    Renders as small as the strokes are large match nothing finer than their pixels: there Gaussians
    differ by chance. The deviation is that of a Gaussian blur of the renders, in pixels. With a
    contrast, edges of more than this stay (He, Sun, Tang: Guided image filtering, ECCV 2010).
    """
    total, weights = torch.zeros_like(colors), torch.zeros_like(colors)
    for view in views:
        image, own = view.render(colors), view.pixels[..., None]
        channels = image.permute(2, 0, 1)
        blurred = smooth(channels, view.pixels, deviation)
        if contrast is not None:
            squares = smooth(channels.square(), view.pixels, deviation)
            variance = (squares - blurred.square()).clamp(min=0).sum(dim=0)
            kept = variance / (variance + contrast**2)
            kept, offset = smooth(
                torch.stack([kept.expand_as(blurred), (1 - kept) * blurred]), view.pixels, deviation
            )
            blurred = kept * channels + offset
        total += view.backproject(blurred.permute(1, 2, 0))
        weights += view.backproject(own.expand_as(image).to(image))
    mean = sh0_from_rgb(total / weights.clamp(min=PAINT_HIDDEN))
    return torch.where(weights > PAINT_HIDDEN, mean, colors)


@torch.no_grad()
def limit_hue_detail(
    colors: Colors,
    views: Sequence[PaintView],
    pictures: Sequence[Float[Tensor, "_ _ 3"]],
    share: float,
) -> Colors:
    """Bring a share of the detail that hues have, and the pictures have not, down to theirs.

    Features hardly tell hues of neighbouring pixels, so that these vary by chance: as coloured
    noise, up to three times as much as in a painting. Luminance stays. The pictures are as large
    as they are beside the object in the views.
    """
    if share == 0:
        return colors
    masks = [away_from_outlines(view.pixels) for view in views]
    images = [_hues(view.render(colors)) for view in views]
    own = [hue_bands(*each) for each in zip(images, masks, strict=True)]
    whole = [torch.ones_like(each[..., 0], dtype=torch.bool) for each in pictures]
    theirs = [hue_bands(_hues(each), mask) for each, mask in zip(pictures, whole, strict=True)]
    ratios = (_energies(theirs, whole) / _energies(own, masks).clamp(min=1e-12)).sqrt()
    excess = share * (1 - ratios).clamp(min=0)
    if not excess.any():
        return colors
    targets = [
        image - torch.einsum("b,bchw->hwc", excess, bands)
        for image, bands in zip(images, own, strict=True)
    ]
    weights, rgb = _settling_weights(views), rgb_from_sh0(colors)
    for _ in range(HUE_ROUNDS):
        off = (
            (target - _hues(view.render(sh0_from_rgb(rgb)))) * mask[..., None]
            for view, target, mask in zip(views, targets, masks, strict=True)
        )
        rgb = rgb + _mean_offsets(views, off, weights)
    return sh0_from_rgb(rgb)


def _settling_weights(views: Sequence[PaintView]) -> Float[Tensor, "P 1"]:
    """What the offsets of the object's pixels are divided by: what shows less moves less."""
    weights = total_weights(views)
    return (weights + PAINT_FAINT * weights[weights > 0].median())[:, None]


def _mean_offsets(
    views: Sequence[PaintView],
    offsets: Iterable[Float[Tensor, "H W 3"]],
    weights: Float[Tensor, "P 1"],
) -> Float[Tensor, "P 3"]:
    """How far to move each colour for the pixels of all views to move by these offsets.

    One round of simultaneous algebraic reconstruction (Gilbert 1972): every pixel's offset is
    backprojected to the Gaussians by their weights.
    """
    pairs = zip(views, offsets, strict=True)
    total = sum((view.backproject(off) for view, off in pairs), torch.zeros(()))
    return PAINT_STRIDE * total / weights


def hue_bands(hues: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"]) -> Float[Tensor, "B 3 H W"]:
    """The detail of hues inside a mask, by its size, the finest first."""
    hues = hues.permute(2, 0, 1)
    own = mask.to(hues)
    means = blurs(hues * own, HUE_BANDS) / blurs(own, HUE_BANDS)[:, None].clamp(min=1e-3)
    levels = torch.cat([hues[None], means]) * own
    return levels[:-1] - levels[1:]


def _energies(
    bands: Sequence[Float[Tensor, "B 3 _ _"]], masks: Sequence[Bool[Tensor, "_ _"]]
) -> Float[Tensor, " B"]:
    """The mean square of each band in all pixels inside the masks."""
    total = torch.stack([each.square().sum(dim=(1, 2, 3)) for each in bands]).sum(dim=0)
    return total / torch.stack([mask.sum() for mask in masks]).sum().clamp(min=1)


def away_from_outlines(mask: Bool[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    """What of a mask is more than `HUE_RIM` pixels inside; its image's border is no outline."""
    outside = F.max_pool2d((~mask)[None].float(), 2 * HUE_RIM + 1, stride=1, padding=HUE_RIM)
    return outside[0] == 0


def _hues(image: Float[Tensor, "H W 3"]) -> Float[Tensor, "H W 3"]:
    """Colours less their luminance."""
    return image - (image @ image.new_tensor(LUMA))[..., None]


@torch.no_grad()
def project_to_palette(
    colors: Colors,
    views: Sequence[PaintView],
    palette: Palette,
    beneath: Bool[Tensor, " P"],
) -> Colors:
    """Move an object's colours until its pixels are near the palette.

    Of Gaussians beneath the strokes the colours themselves are near it: other views may show them
    bare.
    """
    weights, rgb = _settling_weights(views), rgb_from_sh0(colors)
    brightest = rgb.clamp(min=1)  # Gaussians that show in part need colours beyond white
    for _ in range(PAINT_ROUNDS):
        # below black nothing shows, and nothing can be asked for
        rgb = rgb.clamp(min=DARKEST)
        off = (
            palette.offset(view.render(sh0_from_rgb(rgb))) * view.pixels[..., None]
            for view in views
        )
        rgb = (rgb + _mean_offsets(views, off, weights)).minimum(brightest)
        rgb = torch.where(beneath[:, None], rgb + palette.offset(rgb), rgb)
    return sh0_from_rgb(rgb.clamp(min=0))


# W3C, Filter Effects 1, hueRotate: what the sine of the angle is multiplied by
HUE_SINE = ((-0.213, -0.715, 0.928), (0.143, 0.140, -0.283), (-0.787, 0.715, 0.072))
WARMTH = 0.25  # logarithm of red's factor, and of 1 / blue's, at temperature 1
STEEPEST = 2.0  # times the shading of a dark object: more shows its noise
PAINT_DARK = 1e-3  # luma to divide by
# Factor on the contrast of detail: where an object has none it is noise. A fox had 1.0 to 1.3 in
# the Starry Night, 1.3 to 2.0 after a woodcut
MOST_CONTRAST = 2.0
VIEWS, LONGER_SIDE = 4, 160  # of renders that show the colours of an object


@torch.no_grad()
def recolor_map(
    config: RecolorConfig,
    splats: Splats,
    mask: Bool[Tensor, " N"],
    cameras: Cameras,
    picture: Float[Tensor, "P 3"] | None = None,
) -> Float[Tensor, "3 4"]:
    """The affine map of a recolouring.

    Matching the colours of a picture, and tinting, depend on those that the object has.
    """
    luma, one = torch.tensor(LUMA), torch.eye(3)
    grey = torch.ones(3, 1) * luma  # [3, 3], shows the luma of a colour
    steps = []
    if picture is not None or config.tint is not None:
        own = _shown_colors(splats, mask, cameras)
        if picture is not None:
            steps.append(color_map(own, picture))
            own = transform_rgb(own, steps[0])
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


PALETTE_SIZE = 6  # colours that an object is taken to have, at most
PALETTE_SEED = 0  # of k-means
PALETTE_APART = 0.1  # of colours in 0..1: nearer to another's tone curve a colour is a shade of it
PALETTE_RARE = 0.01  # share of the pixels: rarer colours are none of the palette


@torch.no_grad()
def object_palette(
    splats: Splats, mask: Bool[Tensor, " N"], cameras: Cameras
) -> Float[Tensor, "K 3"]:
    """The main colours of an object as its views show them, in 0..1, the most frequent first.

    They are the means of clusters in Lab (k-means), without those that are shades of another.
    """
    colors = thinned(_shown_colors(splats, mask, cameras)).cpu()
    lab = lab_from_rgb(colors).double().numpy()
    _, owners = kmeans2(lab, min(PALETTE_SIZE, len(lab)), minit="++", rng=PALETTE_SEED)
    counts = torch.from_numpy(owners).bincount()
    kept = counts.argsort(descending=True)
    kept = kept[counts[kept] >= max(1, PALETTE_RARE * len(colors))]
    means = torch.stack([colors[torch.from_numpy(owners) == each].mean(dim=0) for each in kept])
    near = tone_curves(means, means)[1] < PALETTE_APART**2
    rows = list[int]()
    for row in range(len(means)):  # shades of a more frequent colour are no colour of their own
        if not near[row, rows].any():
            rows.append(row)
    return means[rows]


def swapped_palette(
    config: RecolorConfig, splats: Splats, mask: Bool[Tensor, " N"], cameras: Cameras
) -> Float[Tensor, "K 6"] | None:
    """The object's palette and what its colours become; None if all of them stay.

    A swap is of the palette's nearest colour.
    """
    if not config.swap:
        return None
    palette = object_palette(splats, mask, cameras)
    after, swapped = palette.clone(), dict[int, str]()
    lab = lab_from_rgb(palette)
    for text in config.swap:
        before, wanted = map(torch.tensor, parse_swap(text))
        row = int(nearest_colors(lab_from_rgb(before[None]), lab))
        if swapped.setdefault(row, text) != text:
            raise StyleSplatError(
                f"{swapped[row]} and {text} begin at the same color of the object, which is "
                f"{hex_of(palette[row])}. Give one of them."
            )
        after[row] = wanted
    return torch.cat([palette, after], dim=1)


def hex_of(color: Float[Tensor, "3"]) -> str:
    """A colour in 0..1 as #rrggbb."""
    return "#" + "".join(f"{level:02x}" for level in (255 * color).round().int().tolist())


def _tint(color: Float[Tensor, " 3"], mean: Float[Tensor, " 3"]) -> Float[Tensor, "3 4"]:
    """The map that takes the mean to a colour, and what is lighter or darker to shades of it."""
    luma = torch.tensor(LUMA)
    shade = color / (color @ luma).clamp(min=PAINT_DARK)  # of luma 1
    steepness = ((color @ luma) / (mean @ luma).clamp(min=PAINT_DARK)).clamp(max=STEEPEST)
    matrix = steepness * shade[:, None] * luma
    return torch.cat([matrix, (color - matrix @ mean)[:, None]], dim=1)


def _shown_colors(
    splats: Splats, mask: Bool[Tensor, " N"], cameras: Cameras
) -> Float[Tensor, "P 3"]:
    """The colours of an object alone in a few views; where none shows it, its Gaussians'."""
    own, shown = splats[mask.nonzero()[:, 0]], []
    for row in evenly_spaced(range(len(cameras)), VIEWS):
        image, alphas = render(own, cameras[row].at_most(LONGER_SIDE))
        shown.append((image / alphas)[alphas[..., 0] > COVERED])
    colors = torch.cat(shown)
    return (colors if len(colors) else rgb_from_sh0(own.sh0[:, 0])).clamp(0, 1)
