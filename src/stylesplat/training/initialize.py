"""The Gaussians that training starts from."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from math import log

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import say
from stylesplat.scene.cameras import Cameras, focus_point
from stylesplat.scene.capture import Capture
from stylesplat.scene.neighbors import nearest_points
from stylesplat.scene.projection import is_in_image, project
from stylesplat.scene.splats import IDENTITY_SIZE, Classifier, Splats, sh0_from_rgb, sh_bases
from stylesplat.training.plane_sweep import SWEEP_SIDE, sweep_planes
from stylesplat.training.views import TrainingView

FIRST_OPACITY = 0.1  # of every first Gaussian (official)
FIRST_NEIGHBORS = 3  # their mean distance is the first radius (official)
# A photo's colour, which is an average, is within this of 95 % of the colours that COLMAP gives the
# points of the fox and the desk, and of 10 % where all are black or white
FIRST_SAME_COLOR = 0.1
MEDIAN_OF = 16  # views at most, which bounds the memory
FIRST_OPAQUE = 0.99  # opacity from which on a transparent photo's colours are its own
UNKNOWN = 0.5  # grey
RANDOM_POINTS = 20_000  # where a capture has no points
SWEPT_ENOUGH = 1000  # points of surfaces: with fewer, random ones are taken
MIN_VIEWS = 0.3  # share of the cameras that see a random point


def with_swept_points(
    capture: Capture,
    rows: Sequence[int],
    view_of: Callable[[int, int], TrainingView],
    generator: torch.Generator,
) -> Capture:
    """A capture without sparse points, with those of the surfaces that some of its photos show.

    `view_of` gives the picture of a row, so many times smaller. Where a capture has sparse points
    they are left alone: after a minute 20,000 more beside them made a fox and a desk .1 to .3 dB
    better and a toy .6 worse, 6,000 the fox .3 better and the desk .5 worse.
    """
    if _has_points(capture):
        return capture
    cameras = capture.cameras[[*rows]]

    def small_view(index: int) -> TrainingView:
        longer = int(cameras.sizes[index].max())
        return view_of(rows[index], max(1, longer // SWEEP_SIDE))

    probe = commonly_visible_points(cameras, RANDOM_POINTS, generator)
    found, shown = (each.cpu() for each in sweep_planes(cameras, small_view, probe))
    if len(found) < SWEPT_ENOUGH:
        return capture
    some = torch.randperm(len(found), generator=generator)[:RANDOM_POINTS]
    say(
        f"The capture has no sparse points: training starts from {len(some):,} on the surfaces "
        "that its photos show together."
    )
    colors = (255 * shown[some]).round().to(torch.uint8)
    return replace(capture, points=found[some], point_colors=colors)


def first_splats(
    capture: Capture,
    *,
    sh_degree: int,
    max_gaussians: int,
    generator: torch.Generator,
    views: Iterable[TrainingView] = (),
    ids: tuple[int, ...] = (),
) -> Splats:
    """One small round Gaussian per point of the capture, or per random point if it has none.

    Colours that none of the `views` shows are replaced; see `photo_colors`. Of more than
    `max_gaussians` points some are taken at random. With label ids, background first, the Gaussians
    get random identities and an untrained classifier.
    """
    points, colors = _points(capture, generator)
    if len(points) > max_gaussians:
        keep = torch.randperm(len(points), generator=generator)[:max_gaussians]
        points, colors = points[keep], colors[keep]
    colors = photo_colors(points, colors, views, generator)
    n = len(points)
    splats = Splats(
        means=points,
        quats=torch.nn.functional.normalize(torch.randn(n, 4, generator=generator), dim=-1),
        scales=neighbor_distances(points).log()[:, None].repeat(1, 3),
        opacities=torch.full((n,), log(FIRST_OPACITY / (1 - FIRST_OPACITY))),
        sh0=sh0_from_rgb(colors)[:, None],
        shN=torch.zeros(n, sh_bases(sh_degree) - 1, 3),
        world_offset=capture.world_offset,
    )
    if not ids:
        return splats
    bound = IDENTITY_SIZE**-0.5  # torch.nn.Linear's
    classifier = Classifier(
        weight=bound * (2 * torch.rand(len(ids), IDENTITY_SIZE, generator=generator) - 1),
        bias=torch.zeros(len(ids)),
        ids=ids,
    )
    identities = torch.randn(n, IDENTITY_SIZE, generator=generator)
    return replace(splats, identities=identities, classifier=classifier)


def neighbor_distances(points: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
    """Mean distance of each point to its nearest neighbours, positive; 1 if there are none."""
    if len(points) < 2:
        return torch.ones(len(points))
    distances, _ = nearest_points(points, points, FIRST_NEIGHBORS + 1)
    distances = distances[:, 1:].numpy()  # 0 is the point itself
    typical = float(np.median(distances)) or 1.0
    return torch.from_numpy(distances.mean(axis=1).clip(1e-3 * typical)).float()


def _has_points(capture: Capture) -> bool:
    return capture.points is not None and len(capture.points) > FIRST_NEIGHBORS


def _points(
    capture: Capture, generator: torch.Generator
) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 3"]]:
    """Points and their colours, which are NaN where they are not known."""
    colors = None
    if _has_points(capture):
        assert capture.points is not None
        points, colors = capture.points.float(), capture.point_colors
    else:
        points = commonly_visible_points(capture.cameras, RANDOM_POINTS, generator)
        count = 0 if capture.points is None else len(capture.points)
        say(
            f"The capture has {f'only {count}' if count else 'no'} sparse points: training starts "
            f"from {len(points):,} random ones in the space that the photos share."
        )
    return points, torch.full_like(points, torch.nan) if colors is None else colors.float() / 255


def photo_colors(
    points: Float[Tensor, "N 3"],
    colors: Float[Tensor, "N 3"],
    views: Iterable[TrainingView],
    generator: torch.Generator,
) -> Float[Tensor, "N 3"]:
    """The colours of points, in 0..1, each replaced unless some view shows it at its point.

    Then a colour is the median of what the views show at the point, whatever hides it in some of
    them; so are unknown colours, which are NaN. What lies in no view stays, or is grey.
    """
    kept = torch.full((MEDIAN_OF, *points.shape), torch.nan)
    counts = torch.zeros(len(points), dtype=torch.long)
    closest = torch.full((len(points),), torch.inf)
    for view in views:
        rows, shown = _shown(points, view)
        error = (shown - colors[rows]).abs().amax(dim=1)
        closest[rows] = torch.fmin(closest[rows], error)
        # Any of the views' colours is kept with the same chance (reservoir sampling)
        slots, counts[rows] = counts[rows], counts[rows] + 1
        drawn = (torch.rand(len(rows), generator=generator) * counts[rows]).long()
        slots = slots.where(slots < MEDIAN_OF, drawn)
        taken = slots < MEDIAN_OF
        kept[slots[taken], rows[taken]] = shown[taken]
    seen, wrong = counts > 0, ~(closest <= FIRST_SAME_COLOR)
    count = int((seen & wrong & ~colors.isnan().any(dim=1)).sum())
    if 2 * count > len(points):
        say(
            f"No photo shows {count:,} of the {len(points):,} points in the colours that the "
            "capture gives them: training starts from what the photos show there."
        )
    medians = kept.nanmedian(dim=0).values
    return medians.where((seen & wrong)[:, None], colors).nan_to_num(UNKNOWN)


def _shown(
    points: Float[Tensor, "N 3"], view: TrainingView
) -> tuple[Int[Tensor, " M"], Float[Tensor, "M 3"]]:
    """The points in a view's picture, hidden or not, and what it shows there, if not nothing."""
    rows = is_in_image(points, view.camera).nonzero()[:, 0]
    x, y = project(points[rows], view.camera)[0].long().unbind(dim=1)
    height, width, _ = view.photo.shape
    x, y = x.clamp(max=width - 1), y.clamp(max=height - 1)
    used = torch.ones_like(rows, dtype=torch.bool)
    if view.alpha is not None:
        used &= view.alpha[y, x, 0] > FIRST_OPAQUE
    if view.valid is not None:
        used &= view.valid[y, x]
    rows, x, y = rows[used], x[used], y[used]
    return rows, view.photo[y, x]


def commonly_visible_points(
    cameras: Cameras, count: int, generator: torch.Generator
) -> Float[Tensor, "N 3"]:
    """Random points in the space that several cameras see, near what they look at."""
    positions = cameras.positions.float()
    focus = focus_point(cameras).float()
    reach = float((positions - focus).norm(dim=-1).median())
    points = focus + reach * (3 * torch.rand(20 * count, 3, generator=generator) - 1.5)
    views = torch.zeros(len(points))
    for camera in cameras:
        views += is_in_image(points, camera)
    common = points[views >= max(1.0, MIN_VIEWS * len(cameras))]
    if len(common) < 100:
        raise StyleSplatError(
            "Cannot start training: the capture has no sparse points, and its cameras look at no "
            "common space. Check the poses, or add points (`ply_file_path` in transforms.json)."
        )
    return common[:count]
