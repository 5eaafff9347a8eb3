"""Colours: CIE Lab, palettes, affine maps between pictures, exposures of photos."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn import functional as F

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import is_in_image, project
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import LUMA, Splats, linear_rgb, map_bands

TO_XYZ = ((0.4124564, 0.3575761, 0.1804375), (0.2126729, 0.7151522, 0.0721750))
TO_XYZ += ((0.0193339, 0.1191920, 0.9503041),)  # sRGB, IEC 61966-2-1
D65 = (0.95047, 1.0, 1.08883)
LOWEST, RANGE = -128.0, 256.0  # L, a and b of all sRGB colours lie well within
COLOR_PIXELS = 2**14  # of a picture that stand for all
COLOR_DISTANCES_AT_ONCE = 2**22  # bounds the colours x colours matrix


def lab_from_rgb(colors: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 3"]:
    """sRGB colours, clamped to 0..1, as L in 0..100, a and b (CIE 1976, white D65)."""
    xyz = linear_rgb(colors.clamp(0, 1)) @ colors.new_tensor(TO_XYZ).T / colors.new_tensor(D65)
    cubes = torch.where(xyz > (6 / 29) ** 3, xyz ** (1 / 3), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = cubes.unbind(-1)
    return torch.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], dim=-1)


@lru_cache(maxsize=8)
@torch.inference_mode(False)  # else training could not use them later
def luma_weights(device: torch.device, dtype: torch.dtype) -> Float[Tensor, " 3"]:
    """`LUMA` on a device, to which it is copied once: every copy makes the host wait."""
    return torch.tensor(LUMA, device=device, dtype=dtype)


def thinned(values: Float[Tensor, "P *D"]) -> Float[Tensor, "_ *D"]:
    """Evenly chosen ones of very many colours, or luminances."""
    return values[evenly_spaced(range(len(values)), COLOR_PIXELS)]


def cells(lab: Float[Tensor, "P 3"], size: float) -> Int[Tensor, " P"]:
    """The number of the cube of this size that each colour lies in."""
    x, y, z = ((lab - LOWEST) / size).long().unbind(-1)
    side = int(RANGE / size) + 1
    return (x * side + y) * side + z


def distinct(colors: Float[Tensor, "P 3"], size: float) -> Float[Tensor, "_ 3"]:
    """The mean of the colours, in 0..1, of each cube of Lab of this size that holds any."""
    places = cells(lab_from_rgb(colors), size)
    _, owners, counts = places.unique(return_inverse=True, return_counts=True)
    return colors.new_zeros(len(counts), 3).index_add_(0, owners, colors) / counts[:, None]


@torch.no_grad()
def nearest_colors(lab: Float[Tensor, "P 3"], palette: Float[Tensor, "Q 3"]) -> Int[Tensor, " P"]:
    """The row of the nearest colour of a palette for each colour, both in Lab (CIE 1976)."""
    if not lab.is_cuda:  # a tree, in a tenth of the time that all distances take
        return torch.from_numpy(KDTree(palette.numpy()).query(lab.numpy())[1])
    columns = torch.cat([-2 * palette.T, palette.square().sum(dim=1)[None]])
    rows = F.pad(lab, (0, 1), value=1.0)
    chunks = rows.split(max(1, COLOR_DISTANCES_AT_ONCE // len(palette)))
    return torch.cat([(chunk @ columns).argmin(dim=1) for chunk in chunks])


SHADE = 5.0  # of Lab: colours in one cube of this size are one
COLOR_NEAR = 6.0  # of Lab: a colour this near to the palette may stay
COLOR_LEVELS = 24  # of red, green and blue in the table of nearest colours


@dataclass(frozen=True, eq=False)
class Palette:
    """The colours of a style, and the nearest of them to any colour."""

    table: Float[Tensor, "_ 4"]
    """The nearest colour in 0..1, by red, green and blue in `COLOR_LEVELS` levels, blue fastest;
    and the share of the way there that ends at distance `COLOR_NEAR`, 0 for nearer colours."""
    strides: Float[Tensor, " 3"]
    """Rows of the table from one level of red, green and blue to the next."""

    def offset(self, colors: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 3"]:
        """From colours in 0..1 to where the palette is near; without gradients."""
        colors = colors.detach()
        levels = (colors.clamp(0, 1) * (COLOR_LEVELS - 1)).round()
        rows = (levels @ self.strides).long().flatten()  # float32 holds these numbers exactly
        found = self.table.index_select(0, rows).view(*colors.shape[:-1], 4)
        return (found[..., :3] - colors) * found[..., 3:]

    def distance(
        self, image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"], area: int
    ) -> Float[Tensor, ""]:
        """The mean squared offset of some pixels, as many as `area`, which gradients shorten."""
        goal = image.detach() + self.offset(image) * mask[..., None]
        return F.mse_loss(image, goal, reduction="sum") / area


@torch.no_grad()
def build_palette(style: Float[Tensor, "Q 3"]) -> Palette:
    """Prepare the colours of a style, in 0..1."""
    palette = distinct(thinned(style), SHADE)  # rarer colours are no aim
    axis = torch.linspace(0, 1, COLOR_LEVELS).to(style)
    every, shades = lab_from_rgb(torch.cartesian_prod(axis, axis, axis)), lab_from_rgb(palette)
    nearest = nearest_colors(every, shades)
    away = (every - shades[nearest]).norm(dim=1)
    shares = (1 - COLOR_NEAR / away).clamp(min=0)
    strides = shares.new_tensor([COLOR_LEVELS**2, COLOR_LEVELS, 1])
    return Palette(torch.cat([palette[nearest], shares[:, None]], dim=1), strides)


COLOR_NOISE = 1e-6  # variance added to both sides, so that flat colours can be inverted


def color_map(source: Float[Tensor, "P 3"], target: Float[Tensor, "Q 3"]) -> Float[Tensor, "3 4"]:
    """The affine map that takes one set of colours to another's mean and covariance.

    Of all such maps it moves the colours least (Pitie & Kokaram 2007, "The linear
    Monge-Kantorovitch linear colour mapping"). The fourth column is the offset.
    """
    noise = COLOR_NOISE * torch.eye(3).to(source)
    root = _matrix_sqrt(source.T.cov(correction=0) + noise)
    inverse = torch.linalg.inv(root)
    wanted = target.T.cov(correction=0) + noise
    matrix = inverse @ _matrix_sqrt(root @ wanted @ root) @ inverse
    offset = target.mean(dim=0) - matrix @ source.mean(dim=0)
    return torch.cat([matrix, offset[:, None]], dim=1)


# Shares of pixels whose luminances a tone curve takes to each other; of the painting's own curve
# beside a straight line from its 10 % to its 90 %, which leaves room in the dark and in the light;
# the curve's slopes at least and at most
TONE_LEVELS = (0.005, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 0.995)
TONE_OWN, TONE_LINE, TONE_SLOPES = 0.65, (0.1, 0.9), (0.35, 1.8)


@dataclass(frozen=True, eq=False)
class ToneCurve:
    """A monotone map of luminances, straight between knots and level beyond them."""

    knots: Float[Tensor, " K"]
    values: Float[Tensor, " K"]

    def __call__(self, luminance: Float[Tensor, "*P"]) -> Float[Tensor, "*P"]:
        right = torch.searchsorted(self.knots, luminance.detach()).clamp(1, len(self.knots) - 1)
        low, high = self.knots[right - 1], self.knots[right]
        share = ((luminance - low) / (high - low)).clamp(0, 1)
        return self.values[right - 1].lerp(self.values[right], share)


@torch.no_grad()
def tone_curve(source: Float[Tensor, " P"], target: Float[Tensor, " Q"]) -> ToneCurve:
    """The curve that takes luminances to those of a painting, and keeps their order.

    The same mean and variance leave flat white or black where the one is skewed and the other not.
    """
    levels = source.new_tensor(TONE_LEVELS)
    knots, tones = (thinned(each).quantile(levels.to(each)) for each in (source, target))
    tones = tones.to(knots)
    low, high = (tones[TONE_LEVELS.index(level)] for level in TONE_LINE)
    line = low + (high - low) * (levels - TONE_LINE[0]) / (TONE_LINE[1] - TONE_LINE[0])
    wanted = line.lerp(tones, TONE_OWN)
    middle = len(levels) // 2
    steps = knots.diff().clamp(min=1e-4)
    knots = torch.cat([knots[:1], knots[0] + steps.cumsum(dim=0)])
    rises = torch.minimum(
        torch.maximum(wanted.diff(), TONE_SLOPES[0] * steps), TONE_SLOPES[1] * steps
    )
    values = torch.cat([rises.new_zeros(1), rises.cumsum(dim=0)])
    values = wanted[middle] + values - values[middle]
    return ToneCurve(knots, values.clamp(tones[0], tones[-1]))


def transform_rgb(
    colors: Float[Tensor, "*P 3"], color_map: Float[Tensor, "3 4"]
) -> Float[Tensor, "*P 3"]:
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


COLOR_POINTS = 2000  # whose colours are compared
COLOR_ROUNDS = 8  # of taking photos' and points' medians in turn
GAIN_DARK, GAIN_BRIGHT = 0.05, 0.98  # colours beyond say nothing about a gain
COLOR_FEWEST = 30  # points by which a photo's gain is estimated


def photo_gains(
    points: Float[Tensor, "M 3"], photos: Iterable[tuple[Float[Tensor, "H W 3"], Cameras]]
) -> Float[Tensor, "C 3"]:
    """The logarithms of each photo's gain per channel of sRGB, whose mean over photos is 0.

    Medians ignore points that are hidden in a photo, or shine. A photo that shows too few points
    has NaN. Each photo comes with a camera of its size.
    """
    some = points[evenly_spaced(range(len(points)), COLOR_POINTS)].cpu()
    logs = torch.stack([_log_colors(some, photo, camera) for photo, camera in photos])  # [C, P, 3]
    known = (~logs.isnan()).all(dim=-1).sum(dim=1) >= COLOR_FEWEST  # [C]
    gains = torch.where(known[:, None], torch.zeros(len(logs), 3), torch.nan)
    if not known.any():
        return gains
    for _ in range(COLOR_ROUNDS):
        typical = (logs - gains[:, None]).nanmedian(dim=0).values  # [P, 3]
        gains = torch.where(known[:, None], (logs - typical).nanmedian(dim=1).values, torch.nan)
        gains = gains - gains.nanmean(dim=0)
    return gains


def _log_colors(
    points: Float[Tensor, "P 3"], photo: Float[Tensor, "H W 3"], camera: Cameras
) -> Float[Tensor, "P 3"]:
    """Logarithms of a photo's colours at points; NaN where they say nothing about a gain."""
    logs = torch.full_like(points, torch.nan)
    rows = is_in_image(points, camera).nonzero()[:, 0]
    x, y = project(points[rows], camera)[0].long().unbind(dim=1)
    height, width, _ = photo.shape
    colors = photo[y.clamp(max=height - 1), x.clamp(max=width - 1)]
    usable = (colors > GAIN_DARK).all(dim=1) & (colors < GAIN_BRIGHT).all(dim=1)
    logs[rows[usable]] = colors[usable].log()
    return logs
