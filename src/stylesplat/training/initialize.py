"""The Gaussians that training starts from."""

from dataclasses import replace
from math import log

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras, focus_point
from stylesplat.scene.capture import Capture
from stylesplat.scene.projection import is_in_image
from stylesplat.scene.splats import IDENTITY_SIZE, Classifier, Splats, sh0_from_rgb, sh_bases

OPACITY = 0.1  # of every first Gaussian (official)
NEIGHBORS = 3  # their mean distance is the first radius (official)
RANDOM_POINTS = 20_000  # where a capture has no points
MIN_VIEWS = 0.3  # share of the cameras that see a random point


def first_splats(
    capture: Capture,
    *,
    sh_degree: int,
    max_gaussians: int,
    generator: torch.Generator,
    ids: tuple[int, ...] = (),
) -> Splats:
    """One small round Gaussian per point of the capture, or per random point if it has none.

    Of more than `max_gaussians` points some are taken at random. With label ids, background first,
    the Gaussians get random identities and an untrained classifier.

    Raises:
        StyleSplatError: If there are no points and no space that several cameras see.
    """
    points, colors = _points(capture, generator)
    if len(points) > max_gaussians:
        keep = torch.randperm(len(points), generator=generator)[:max_gaussians]
        points, colors = points[keep], colors[keep]
    n = len(points)
    splats = Splats(
        means=points,
        quats=torch.nn.functional.normalize(torch.randn(n, 4, generator=generator), dim=-1),
        scales=neighbor_distances(points).log()[:, None].repeat(1, 3),
        opacities=torch.full((n,), log(OPACITY / (1 - OPACITY))),
        sh0=sh0_from_rgb(colors.float() / 255)[:, None],
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
    array = points.numpy()
    count = min(NEIGHBORS, len(array) - 1)
    distances = KDTree(array).query(array, k=count + 1)[0][:, 1:]  # 0 is the point itself
    typical = float(np.median(distances)) or 1.0
    return torch.from_numpy(distances.mean(axis=1).clip(1e-3 * typical)).float()


def scene_extent(cameras: Cameras) -> float:
    """Radius of the cameras around their mean, the official code's unit of length."""
    centred = cameras.positions - cameras.positions.mean(dim=0)
    return 1.1 * float(centred.norm(dim=-1).max()) or 1.0


def _points(capture: Capture, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    colors = None
    if capture.points is not None and len(capture.points) > NEIGHBORS:
        points, colors = capture.points.float(), capture.point_colors
    else:
        points = commonly_visible_points(capture.cameras, RANDOM_POINTS, generator)
    return points, torch.full_like(points, 128, dtype=torch.uint8) if colors is None else colors


def commonly_visible_points(
    cameras: Cameras, count: int, generator: torch.Generator
) -> Float[Tensor, "N 3"]:
    """Random points in the space that several cameras see, near what they look at.

    Raises:
        StyleSplatError: If the cameras look at no common space.
    """
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
