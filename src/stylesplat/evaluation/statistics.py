"""What NNFM leaves open: whether all of the style arrives, and what is left of the object."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.metrics.lab import LUMA
from stylesplat.metrics.ssim import ssim_map
from stylesplat.rendering.one_view import render
from stylesplat.rendering.shares import COVERED
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.views import ObjectView

TINY = 1e-12  # keeps 0 / 0 at 0: a style without any feature or any contrast


@dataclass(frozen=True)
class Moments:
    """Mean and covariance of a set of features."""

    count: int
    """How many there are."""
    mean: Float[Tensor, " D"]
    """One number per channel."""
    covariance: Float[Tensor, "D D"]
    """Of the set as it is, divided by `count`."""


def style_statistics_distance(
    feats: Float[Tensor, "P D"], style_feats: Float[Tensor, "Q D"]
) -> Float[Tensor, ""]:
    """Relative distance between the means and the covariances of two sets of features.

    `(|m - m_s| / |m_s| + |C - C_s| / |C_s|) / 2`, with the Euclidean and the Frobenius norm. The
    match of both is how AdaIN and WCT define a style (Huang & Belongie 2017, Li et al. 2017);
    unlike NNFM it also notices which parts of the style are missing.

    Args:
        feats: Of the render, one row per pixel.
        style_feats: Of the style image.

    Returns:
        0 if they agree; the same if both sets are scaled or copied.
    """
    return _distance(moments(feats), moments(style_feats))


@torch.no_grad()
def object_statistics_distance(
    splats: Splats,
    views: Sequence[ObjectView],
    targets: Sequence[Float[Tensor, "_ _"]],
    network: FeatureNetwork,
    blocks: Sequence[int],
) -> float:
    """`style_statistics_distance` of an object's features in all views, averaged over blocks.

    Args:
        splats: The scene.
        views: Of the object; at least one.
        targets: The style's features of each block.
        network: Whose features are compared.
        blocks: Which blocks of it.
    """

    def one_view(view: ObjectView) -> list[Moments]:
        image, _ = render(splats, view.camera)
        feats = network(image.clamp(0, 1), blocks)
        return [moments(f[cells]) for f, cells in zip(feats, view.cells, strict=True)]

    def merge(one: list[Moments], other: list[Moments]) -> list[Moments]:
        return [pool(a, b) for a, b in zip(one, other, strict=True)]

    pooled = reduce(merge, map(one_view, views))
    distances = [_distance(p, moments(t)) for p, t in zip(pooled, targets, strict=True)]
    return float(torch.stack(distances).mean())


def moments(feats: Float[Tensor, "P D"]) -> Moments:
    """Mean and covariance of features, one per row."""
    covariance = feats.T.cov(correction=0).view(2 * feats.shape[1:])  # [D, D] for D = 1 too
    return Moments(len(feats), feats.mean(dim=0), covariance)


def pool(one: Moments, other: Moments) -> Moments:
    """The moments of two sets taken together (Chan et al. 1979), exact to rounding."""
    count = one.count + other.count
    share = other.count / count
    gap = other.mean - one.mean
    between = share * (1 - share) * torch.outer(gap, gap)
    within = torch.lerp(one.covariance, other.covariance, share)
    return Moments(count, one.mean + share * gap, within + between)


@torch.no_grad()
def content_ssim(
    base: Splats,
    styled: Splats,
    cameras: Cameras,
    picked: Bool[Tensor, " N"],
) -> float | None:
    """How much of an object's shading and texture is left: SSIM before to after, of luminance.

    Args:
        base: The scene before.
        styled: The scene after, which may have other Gaussians.
        cameras: The views to compare in, at their size.
        picked: The object's Gaussians in `base`.

    Returns:
        1 if nothing changed. The mean over the object's pixels, then over the views that show
        it; None if none does.
    """
    scores = []
    for index in range(len(cameras)):
        features = picked.to(base.means)[:, None]
        before = render(base, cameras[index], features=features)[0]
        covered = before[..., 3] > COVERED
        if covered.any():
            after = render(styled, cameras[index])[0]
            similarity = ssim_map(_luminance(before[..., :3]), _luminance(after))[0]
            scores.append(similarity[covered].mean())
    return float(torch.stack(scores).mean()) if scores else None


def _luminance(image: Float[Tensor, "H W 3"]) -> Float[Tensor, "1 H W"]:
    return (image.clamp(0, 1) @ image.new_tensor(LUMA))[None]


def _distance(found: Moments, style: Moments) -> Float[Tensor, ""]:
    pairs = ((found.mean, style.mean), (found.covariance, style.covariance))
    relative = [(x - y).norm() / y.norm().clamp(min=TINY) for x, y in pairs]
    return torch.stack(relative).mean()
