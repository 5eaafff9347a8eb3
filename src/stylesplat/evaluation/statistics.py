"""What NNFM does not measure: statistics of features, colours, and the object's own content."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.metrics.images import ssim_map
from stylesplat.metrics.lab import LUMA, cells, distinct, lab_from_rgb, nearest_colors, thinned
from stylesplat.rendering.render import render
from stylesplat.rendering.shares import COVERED, colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.views import ObjectView

TINY = 1e-12  # keeps 0 / 0 at 0: a style without any feature or any contrast
TOLERANCE = 10.0  # of Lab, from which a colour is another one, rather than another shade
SAME = 1.0  # of Lab, the size of the cubes whose colours count as one
SURELY_NEAR = 5.0  # of Lab: no colours in a cube of this size are farther apart than 8.7
DIRECTIONS = 64  # that palettes are projected on
QUANTILES = 256  # by which two projections are compared


def style_statistics_distance(
    feats: Float[Tensor, "P D"], style_feats: Float[Tensor, "Q D"]
) -> Float[Tensor, ""]:
    """Relative distance between the means and the covariances of two sets of features.

    `(|m - m_s| / |m_s| + |C - C_s| / |C_s|) / 2`, with the Euclidean and the Frobenius norm. The
    match of both is how AdaIN and WCT define a style (Huang & Belongie 2017, Li et al. 2017);
    unlike NNFM it also notices which parts of the style are missing.

    Returns:
        0 if they agree; the same if both sets are scaled or copied.
    """
    found, style = ((rows.mean(dim=0), rows.T.cov(correction=0)) for rows in (feats, style_feats))
    relative = [
        (x - y).norm() / y.norm().clamp(min=TINY) for x, y in zip(found, style, strict=True)
    ]
    return torch.stack(relative).mean()


@torch.no_grad()
def object_statistics_distance(
    splats: Splats,
    views: Sequence[ObjectView],
    targets: Sequence[Float[Tensor, "_ _"]],
    network: FeatureNetwork,
    blocks: Sequence[int],
) -> float:
    """`style_statistics_distance` of an object's features in all views, averaged over blocks."""
    by_view = []
    for view in views:
        feats = network(render(splats, view.camera)[0].clamp(0, 1), blocks)
        by_view.append([f[mask] for f, mask in zip(feats, view.cells, strict=True)])
    distances = [
        style_statistics_distance(torch.cat(feats), target)
        for feats, target in zip(zip(*by_view, strict=True), targets, strict=True)
    ]
    return float(torch.stack(distances).mean())


@torch.no_grad()
def content_ssim(
    base: Splats,
    styled: Splats,
    cameras: Cameras,
    picked: Bool[Tensor, " N"],
) -> float | None:
    """SSIM of an object's luminance before and after: how much of its content is left.

    Returns:
        1 if nothing changed. The mean over the object's pixels, then over the views that show
        it; None if none does.
    """
    scores = []
    for index in range(len(cameras)):
        before, coverage = colors_and_coverage(base, cameras[index], picked)
        covered = coverage[..., 0] > COVERED
        if covered.any():
            after = render(styled, cameras[index])[0]
            luminances = [(i.clamp(0, 1) @ i.new_tensor(LUMA))[None] for i in (before, after)]
            scores.append(ssim_map(*luminances)[0][covered].mean())
    return float(torch.stack(scores).mean()) if scores else None


def off_palette(colors: Float[Tensor, "P 3"], style: Float[Tensor, "Q 3"]) -> float:
    """The share of colours that are farther than 10 in Lab (CIE 1976) from all of the style.

    All are in 0..1. A large set is sampled evenly; colours of the style that differ by less than
    about 1 count as one.
    """
    lab = lab_from_rgb(thinned(colors))
    palette = lab_from_rgb(distinct(style, SAME))
    far = ~torch.isin(cells(lab, SURELY_NEAR), cells(palette, SURELY_NEAR))
    if not far.any():
        return 0.0
    others = lab[far]
    distances = (others - palette[nearest_colors(others, palette)]).norm(dim=1)
    return int((distances > TOLERANCE).sum()) / len(lab)


def palette_distance(
    colors: Float[Tensor, "P 3"], style: Float[Tensor, "Q 3"], *, seed: int = 0
) -> float:
    """The sliced Wasserstein distance of two sets of colours, in Lab.

    Returns:
        The root mean square over directions and quantiles; 0 if both sets have the same
        distribution, 1 / sqrt(3) of the distance if all colours are moved by the same.
    """
    generator = torch.Generator().manual_seed(seed)
    directions = F.normalize(torch.randn(3, DIRECTIONS, generator=generator), dim=0).to(colors)
    levels = ((torch.arange(QUANTILES) + 0.5) / QUANTILES).to(colors)
    one, other = (
        (lab_from_rgb(thinned(each)) @ directions).quantile(levels, dim=0)
        for each in (colors, style)
    )
    return float((one - other).square().mean().sqrt())
