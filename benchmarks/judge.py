"""The figures by which a painted object is judged, independent of how it was painted.

All but the time are of renders before and after, in held-out views; nothing is taken from the
optimisation but feature networks and the formula of NNFM.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from statistics import mean, median

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.evaluation.changes import largest_area, view_consistency
from stylesplat.evaluation.style import content_ssim
from stylesplat.imaging.color import LUMA
from stylesplat.rendering.render import render
from stylesplat.rendering.weights import COVERED, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.matching import nnfm_loss

SIZES = {"full": 1.0, "half": 0.5}  # of the photos
STYLE_SIZE = 2.0  # longer side of the painting, in those of the object: strokes of the usual size
BLOCK = 3  # of the networks
MOST = 3000  # features of a view, evenly chosen, that stand for all
MARGIN = 20  # pixels around the object in a crop
FINE, COARSE = 0.01, 0.08  # of the object's extent: a feature of it is larger and smaller
NEAR = 0.05  # of the extent: what lies around a place
PLAIN = 0.02  # standard deviation of the luminance: a place with as much counts half
TINY = 1e-6
SEEN = 0.25  # of the area in the view that shows most of the object: less is no view of it
SMALL = 200  # pixels: the longer side at which these areas are measured
CHANGED, UNCHANGED = 0.05, 0.02  # of a channel's range

Networks = Mapping[str, FeatureNetwork]
Figures = dict[str, float]


@dataclass(frozen=True)
class Sight:
    """An object before it is painted, in a crop of one view."""

    camera: Cameras
    """The whole view's."""
    crop: tuple[slice, slice]
    """Rows and columns of it that show the object, with a margin."""
    before: Float[Tensor, "H W 3"]
    """Colours in 0..1, cropped."""
    share: Float[Tensor, "H W"]
    """The object's share of each pixel, cropped."""
    extent: int
    """The object's longer side in pixels, without the outermost half percent."""

    @property
    def mask(self) -> Bool[Tensor, "H W"]:
        """The pixels that are the object's."""
        return self.share > COVERED

    def shows(self, splats: Splats) -> Float[Tensor, "H W 3"]:
        """The same crop of other splats."""
        return render(splats, self.camera)[0].clamp(0, 1)[self.crop]


@torch.no_grad()
def find_sights(splats: Splats, cameras: Cameras, picked: Tensor, count: int) -> list[Sight]:
    """The object in so many views that show much of it, at equal distances."""
    views = [cameras[row] for row in range(len(cameras))]
    areas = [float((coverage(splats, v.at_most(SMALL), picked) > COVERED).sum()) for v in views]
    good = [v for v, area in zip(views, areas, strict=True) if area > SEEN * max(areas)]
    return [_sight(splats, view, picked) for view in evenly_spaced(good, count)]


def _sight(splats: Splats, camera: Cameras, picked: Tensor) -> Sight:
    share = coverage(splats, camera, picked).clamp(0, 1)
    pixels = (share > COVERED).nonzero().float()
    low, high = pixels.quantile(0.005, dim=0), pixels.quantile(0.995, dim=0)
    first, last = pixels.amin(dim=0).int() - MARGIN, pixels.amax(dim=0).int() + MARGIN + 1
    rows, columns = (
        slice(max(0, a), b) for a, b in zip(first.tolist(), last.tolist(), strict=True)
    )
    crop = (rows, columns)
    before = render(splats, camera)[0].clamp(0, 1)
    return Sight(camera, crop, before[crop], share[crop], int((high - low).max()))


@torch.no_grad()
def features_kept(
    sights: Sequence[Sight], images: Sequence[Float[Tensor, "H W 3"]]
) -> tuple[float, float]:
    """The correlation of the object's luminance before and after, in a band of sizes.

    Between 1 and 8 % of the object's extent lie eyes and mouths; strokes are finer, light and the
    palette coarser.

    Returns:
        The correlation over all of the object, and the mean of those around each place that is
        not plain: the first goes by what has most contrast, such as a dark frame around a sign,
        the other by faint features, too. Both are means over views.
    """
    found = []
    for sight, image in zip(sights, images, strict=True):
        mask, extent = sight.mask.float(), sight.extent
        one, other = (_band(each, mask, extent) for each in (sight.before, image))

        def around(values: Tensor, mask: Tensor = mask, extent: int = extent) -> Tensor:
            return _mean_around(values, mask, NEAR * extent)

        means = around(one), around(other)
        squares = around(one * one) - means[0] ** 2, around(other * other) - means[1] ** 2
        old, new = (each.clamp(min=0).sqrt()[sight.mask] for each in squares)
        local = (around(one * other) - means[0] * means[1])[sight.mask] / (old * new + TINY)
        whole = torch.stack([one[sight.mask], other[sight.mask]])
        correlation = float(whole.corrcoef()[0, 1].nan_to_num())
        weights = old**2 / (old**2 + PLAIN**2)
        found.append((correlation, float((local * weights).sum() / (weights.sum() + TINY))))
    whole, local = (mean(column) for column in zip(*found, strict=True))
    return whole, local


def _band(image: Tensor, mask: Tensor, extent: int) -> Tensor:
    grey = image @ image.new_tensor(LUMA)
    fine, coarse = (_mean_around(grey, mask, size * extent) for size in (FINE, COARSE))
    return fine - coarse


def _mean_around(values: Tensor, mask: Tensor, deviation: float) -> Tensor:
    """Of what lies in the mask, weighted by a Gaussian."""
    return _blurred(values * mask, deviation) / _blurred(mask, deviation).clamp(min=1e-3)


def _blurred(image: Tensor, deviation: float) -> Tensor:
    return torch.from_numpy(cv2.GaussianBlur(image.cpu().numpy(), (0, 0), deviation))


@torch.no_grad()
def nnfm_of_views(
    sights: Sequence[Sight],
    images: Sequence[Float[Tensor, "H W 3"]],
    painting: Float[Tensor, "_ _ 3"],
    network: FeatureNetwork,
    size: float,
) -> list[float]:
    """NNFM in each view, exact, at a share of the photos' size."""
    target = painting_features(sights, painting, network, size)
    losses = []
    for sight, image in zip(sights, images, strict=True):
        feats = own_features(sight, image, network, size)
        chosen = torch.linspace(0, len(feats) - 1, min(MOST, len(feats))).long()
        losses.append(float(nnfm_loss(feats[chosen].float(), target.float())))
    return losses


@torch.no_grad()
def painting_features(
    sights: Sequence[Sight], painting: Tensor, network: FeatureNetwork, size: float
) -> Float[Tensor, "Q D"]:
    """What strokes of the usual size look like on these objects, without the picture's border."""
    longer = STYLE_SIZE * median(sight.extent for sight in sights) * size
    image = resized(painting, longer / max(painting.shape[:2]))
    (feats,) = network(image, (BLOCK,))
    cells = network.cells(BLOCK)
    inside = feats[cells.inside(image.shape[0]), cells.inside(image.shape[1])]
    return inside.reshape(-1, inside.shape[-1])


def own_features(
    sight: Sight, image: Float[Tensor, "H W 3"], network: FeatureNetwork, size: float
) -> Float[Tensor, "P D"]:
    """Features of the object's own places."""
    (feats,) = network(resized(image, size), (BLOCK,))
    share = resized(sight.share[..., None], size)[..., 0]
    own = F.avg_pool2d(share[None], network.cells(BLOCK).stride)[0] > COVERED
    return feats[: own.shape[0], : own.shape[1]][own]


def resized(image: Float[Tensor, "_ _ D"], factor: float) -> Float[Tensor, "_ _ D"]:
    """A picture of another size, smoothed where it becomes smaller."""
    if factor == 1:
        return image
    size = [max(1, round(factor * side)) for side in image.shape[:2]]
    planes = image.permute(2, 0, 1)[None]
    found = F.interpolate(planes, size, mode="bicubic", antialias=True)
    return found[0].permute(1, 2, 0).clamp(0, 1)


def outline_errors(
    before: Float[Tensor, "H W 3"],
    after: Float[Tensor, "H W 3"],
    inside: Bool[Tensor, "H W"],
    reach: float,
) -> tuple[float, float, int]:
    """What of the paint lies beside an outline, and what of the object has none.

    Returns:
        The pixels farther outside than `reach` that changed, as a share of the object's; the
        share of those farther inside that did not; and how many of the former are the largest
        area.
    """
    difference = (after - before).abs().amax(dim=-1)
    deep = distances(inside) > reach
    stained = (distances(~inside) > reach) & (difference > CHANGED)
    missed = (deep & (difference <= UNCHANGED)).sum() / deep.sum()
    return float(stained.sum() / inside.sum()), float(missed), largest_area(stained)


def distances(mask: Bool[Tensor, "H W"]) -> Float[Tensor, "H W"]:
    """How far each pixel of a mask lies from the others."""
    found = cv2.distanceTransform(mask.numpy().astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return torch.from_numpy(found)


@torch.no_grad()
def outline_figures(
    before: Splats, after: Splats, outlines: Sequence[tuple[Cameras, Tensor]], reach: float
) -> Figures:
    """Spill and what is missed in percent, the means over the views whose outlines are known, and
    the largest stain of all."""
    found = []
    for camera, inside in outlines:
        old, new = (render(splats, camera)[0].clamp(0, 1) for splats in (before, after))
        found.append(outline_errors(old, new, inside, reach))
    spills, misses, stains = zip(*found, strict=True)
    return {
        "spill %": 100 * mean(spills),
        "missed %": 100 * mean(misses),
        "stain px": max(stains),
    }


@torch.no_grad()
def judge(
    before: Splats,
    after: Splats,
    picked: Bool[Tensor, " N"],
    sights: Sequence[Sight],
    images: Sequence[Float[Tensor, "H W 3"]],
    painting: Float[Tensor, "_ _ 3"],
    cameras: Cameras,
    networks: Networks,
) -> Figures:
    """What needs neither outlines nor label maps.

    Args:
        before: The scene.
        after: The painted scene.
        picked: The object's Gaussians in `before`.
        sights: The views to judge.
        images: What they show of the painted scene.
        painting: The style, colours in 0..1.
        cameras: Views in the order of the photos, for their consistency.
        networks: By name, those that NNFM goes by.
    """
    kept, local = features_kept(sights, images)
    found = {"kept": kept, "kept local": local}
    for name, network in networks.items():
        for size, share in SIZES.items():
            losses = nnfm_of_views(sights, images, painting, network, share)
            found[f"{name} {size}"] = mean(losses)
    views = reduce(add, (sight.camera for sight in sights))
    found["SSIM"] = content_ssim(before, after, views, picked) or 0.0
    near = view_consistency(before, after, cameras, picked)
    if "short_range_rmse" in near:
        found["near"] = near["short_range_rmse"]
        found["near before"] = near["short_range_rmse_base"]
        found["near ratio"] = found["near"] / found["near before"]
    return found
