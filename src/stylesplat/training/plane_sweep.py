"""Points on the surfaces that photos show: training that starts from them need not find these.

Plane sweep (Collins: A space-sweep approach to true multi-image matching, CVPR 1996): at many
depths before a photo, others are projected onto a plane. Where they look as the photo does, by the
zero-mean normalised cross-correlation of small windows, there is a surface. A point is kept if the
depths of a second photo confirm it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.imaging.color import luma_weights
from stylesplat.rendering.view_pool import per_view
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import (
    depths_of,
    is_in_image,
    pixel_centres,
    project,
    unproject,
)
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.training.views import TrainingView

SWEEP_SIDE = 160  # pixels of the photos' longer side, at least: they are whole times smaller
SWEPT_PHOTOS = 16  # whose depths are found
SWEEP_BESIDE = 4  # other photos that each of them is compared with
# Of these: the best distance of the cameras, over that of what they show, and the least
SWEEP_APART, SWEEP_LEAST = 0.12, 0.02
SWEEP_TURN = 1.0  # radians between the views, at most
SWEEP_TURNED = 0.3  # what such a turn counts, beside the distance from the best one
SWEEP_PLANES = 48  # even in 1 / depth
SWEEP_MARGINS = 0.7, 1.5  # of the depths of known points: where planes begin and end
SWEEP_RANGE = 0.01, 0.99  # quantiles of these
SWEEP_PROBES = 20  # points that a photo has to show, to tell its depths
SWEEP_WINDOW = 5  # pixels
SWEEP_PLAIN = 1e-4  # variance of the luminance of a window that shows nothing to compare
SWEEP_ALIKE, SWEEP_ALONE = 0.75, 0.2  # correlation at least, and by how much above the median
SAME_DEPTH = 0.03  # of it: depths of two photos that are one
SWEEP_WHOLE = 0.97  # of a window is valid, or of a pixel opaque, at least


@dataclass(frozen=True)
class SweptPhoto:
    """The surface that a photo shows."""

    camera: Cameras
    depths: Float[Tensor, "H W"]
    is_found: Bool[Tensor, "H W"]
    colors: Float[Tensor, "H W 3"]


@torch.no_grad()
def sweep_planes(
    cameras: Cameras, view_of: Callable[[int], TrainingView], probe: Float[Tensor, "P 3"]
) -> tuple[Float[Tensor, "M 3"], Float[Tensor, "M 3"]]:
    """Points on surfaces, and their colours, in 0..1.

    Args:
        cameras: Those to learn from.
        view_of: A small picture of each, by its row; pixels that are not to be learned from, or
            are transparent, give no points.
        probe: Points that lie about where the surfaces do, which tell the range of depths.
    """
    rows = evenly_spaced(range(len(cameras)), SWEPT_PHOTOS)
    pairs = [(row, _beside(cameras, row, probe)) for row in rows]
    needed = {row for one, others in pairs for row in (one, *others)}
    views = {row: view_of(row) for row in sorted(needed)}

    def look(pair: tuple[int, Sequence[int]]) -> SweptPhoto | None:
        row, others = pair
        return _sweep_photo(views[row], [views[each] for each in others], probe)

    device = views[rows[0]].photo.device
    found = per_view(look, pairs, "finding surfaces", device)
    swept = [each for each in found if each is not None]
    parts = [_confirmed(each, swept) for each in swept]
    empty = probe.new_zeros(0, 3)
    points, colors = zip(*parts, strict=True) if parts else ([empty], [empty])
    return torch.cat([*points]), torch.cat([*colors])


def _beside(cameras: Cameras, row: int, probe: Float[Tensor, "P 3"]) -> list[int]:
    """The rows of the photos that a photo is compared with."""
    depths = _depths_in_image(probe, cameras[row])
    if len(depths) < SWEEP_PROBES:
        return []
    apart = (cameras.positions - cameras.positions[row]).norm(dim=1) / depths.median()
    axes = cameras.viewmats[:, 2, :3]
    turned = (axes @ axes[row]).clamp(-1, 1).acos()
    unlike = (apart - SWEEP_APART).abs() + SWEEP_TURNED * turned
    unlike[(apart < SWEEP_LEAST) | (turned > SWEEP_TURN)] = torch.inf
    best = unlike.argsort()[:SWEEP_BESIDE]
    return best[unlike[best].isfinite()].tolist()


def _sweep_photo(
    view: TrainingView, others: Sequence[TrainingView], probe: Float[Tensor, "P 3"]
) -> SweptPhoto | None:
    """The depths at which other photos show the same; None where too few do."""
    camera, picture = view.camera, _luminance(view)
    depths = _depths_in_image(probe.to(picture), camera)
    if len(others) < 2 or len(depths) < SWEEP_PROBES:
        return None
    near, far = (
        float(depths.quantile(at)) * margin
        for at, margin in zip(SWEEP_RANGE, SWEEP_MARGINS, strict=True)
    )
    closeness = torch.linspace(1 / near, 1 / far, SWEEP_PLANES, device=picture.device)
    mean = _window_mean(picture)
    variance = _window_mean(picture.square()) - mean.square()
    scores = list[Tensor]()
    for other in others:
        shown, inside = _shown_on_planes(camera, other, closeness)
        means = _window_mean(shown)
        variances = _window_mean(shown.square()) - means.square()
        both = _window_mean(shown * picture) - means * mean
        alike = both / (variances.clamp(min=0) * variance + SWEEP_PLAIN**2).sqrt()
        scores.append(torch.where(inside, alike, -1.0))
    # what hides the surface in one photo does not in all
    most = max(2, len(others) // 2)
    score = torch.stack(scores).topk(most, dim=0).values.mean(dim=0)
    best, plane = score.max(dim=0)
    inner = plane.clamp(1, SWEEP_PLANES - 2)
    left, middle, right = (score.gather(0, inner[None] + step)[0] for step in (-1, 0, 1))
    peak = (left - right) / (2 * (left - 2 * middle + right).clamp(max=-1e-6))  # of a parabola
    step = (closeness[-1] - closeness[0]) / (SWEEP_PLANES - 1)
    depths = 1 / (closeness[0] + (inner + peak.clamp(-0.5, 0.5)) * step)
    is_found = (plane == inner) & (best > SWEEP_ALIKE) & (variance > SWEEP_PLAIN)
    is_found &= best - score.median(dim=0).values > SWEEP_ALONE
    if view.valid is not None:
        is_found &= _window_mean(view.valid.float()) > SWEEP_WHOLE
    if view.alpha is not None:
        is_found &= view.alpha[..., 0] > SWEEP_WHOLE
    return SweptPhoto(camera, depths, is_found, view.photo)


def _depths_in_image(points: Float[Tensor, "P 3"], camera: Cameras) -> Float[Tensor, " M"]:
    return depths_of(points, camera)[is_in_image(points, camera)]


def _luminance(view: TrainingView) -> Float[Tensor, "H W"]:
    """That of a photo, black where it is not to be learned from."""
    luminance = view.photo @ luma_weights(view.photo.device, view.photo.dtype)
    return luminance if view.valid is None else luminance * view.valid


def _window_mean(images: Float[Tensor, "*D H W"]) -> Float[Tensor, "*D H W"]:
    flat = images.reshape(-1, 1, *images.shape[-2:])
    means = F.avg_pool2d(flat, SWEEP_WINDOW, 1, SWEEP_WINDOW // 2, count_include_pad=False)
    return means.reshape(images.shape)


def _shown_on_planes(
    camera: Cameras, other: TrainingView, closeness: Float[Tensor, " D"]
) -> tuple[Float[Tensor, "D H W"], Bool[Tensor, "D H W"]]:
    """What another photo shows on planes before a camera, and where it shows them."""
    width, height = camera.size
    pixels = pixel_centres(width, height).to(closeness)
    ones = pixels.new_ones(len(pixels), 1)
    # places in the other image are linear in 1 / depth, in homogeneous coordinates
    at_once = unproject(pixels, ones[:, 0], camera), unproject(pixels, 2 * ones[:, 0], camera)
    there = other.camera.viewmats[0].to(closeness)
    first, second = (places @ there[:3, :3].T + there[:3, 3] for places in at_once)
    direction, origin = second - first, 2 * first - second
    K = other.camera.Ks[0].to(closeness)
    places = (direction + origin * closeness[:, None, None]) @ K.T
    scale = places[..., 2:].clamp(min=1e-6)
    size = closeness.new_tensor(other.camera.size)
    grid = 2 * places[..., :2] / scale / size - 1
    inside = (grid.abs() <= 1).all(dim=-1) & (places[..., 2] > 1e-6)
    picture = _luminance(other)[None, None].expand(len(closeness), -1, -1, -1)
    grid = grid.view(len(closeness), height, width, 2)
    shown = F.grid_sample(picture, grid, align_corners=False)[:, 0]
    return shown, inside.view(shown.shape)


def _confirmed(
    photo: SweptPhoto, swept: Sequence[SweptPhoto]
) -> tuple[Float[Tensor, "M 3"], Float[Tensor, "M 3"]]:
    """The points of a photo that the depths of another one confirm, and their colours."""
    width, height = photo.camera.size
    rows = photo.is_found.reshape(-1).nonzero()[:, 0]
    pixels = pixel_centres(width, height).to(photo.depths)[rows]
    points = unproject(pixels, photo.depths.reshape(-1)[rows], photo.camera)
    is_same = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    for other in swept:
        if other is photo:
            continue
        some = (is_in_image(points, other.camera) & ~is_same).nonzero()[:, 0]
        places, depths = project(points[some], other.camera)
        x, y = torch.minimum(places.long(), other.camera.sizes[0].to(rows) - 1).unbind(dim=1)
        near = (other.depths[y, x] - depths).abs() < SAME_DEPTH * depths
        is_same[some] = near & other.is_found[y, x]
    return points[is_same], photo.colors.reshape(-1, 3)[rows[is_same]]
