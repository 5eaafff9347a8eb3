"""Where the surface is that a camera sees: of balls and walls it is known."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from scenes import BACKENDS, cloud, device_of, leaf, random_splats, shell, two_cameras
from stylesplat.rendering.reference import mean_depths
from stylesplat.rendering.render import Backend
from stylesplat.rendering.surface import (
    SURFACE_BESIDE,
    SURFACE_HOLE,
    SURFACE_PULLS,
    SURFACE_SHARES,
    DepthMap,
    average_in_voxels,
    depth_map,
    front_depth,
    near_side_depth_map,
    project_into_silhouettes,
    surface_points,
)
from stylesplat.rendering.weights import COVERED, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

ANY = ["reference", *BACKENDS]
CLOUD, CAMERA = random_splats(), two_cameras()[1]
PICKED = torch.arange(len(CLOUD)) % 3 == 0
RADIUS = 0.6


def wall(depth: float, normal: list[float], opacity: float = 9.0) -> Splats:
    """One wide, flat Gaussian through (0, 0, depth), which fills the middle of the view."""
    z = F.normalize(torch.tensor(normal), dim=0)
    quat = torch.tensor([[1 + z[2], -z[1], z[0], 0.0]])  # turns the z axis to the normal
    scales = torch.tensor([[0.6, 0.6, 1e-3]]).log()
    place = CAMERA.positions[0] + torch.tensor([0.0, 0.0, depth])
    return replace(cloud(place[None], opacity=opacity), quats=quat, scales=scales)


def ball(count: int = 4000) -> Splats:
    """Opaque discs on a sphere around the origin."""
    normals = shell(count, 1.0)
    x, y, z = normals.unbind(1)
    quats = torch.stack([1 + z, -y, x, torch.zeros_like(z)], dim=1)
    scales = torch.tensor([0.03, 0.03, 0.001]).log().expand(count, 3).clone()
    return replace(cloud(RADIUS * normals, opacity=6.0), quats=quats, scales=scales)


def middle(image: Tensor) -> Tensor:
    return image[20:30, 28:38]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("picked", [None, PICKED], ids=["all", "some"])
@pytest.mark.parametrize("shares", [(0.0, 1.0), SURFACE_SHARES, (0.45, 0.55)])
def test_depths_are_the_references(
    backend: Backend, picked: Tensor | None, shares: tuple[float, float]
):
    device = device_of(backend)
    splats, mask = CLOUD.to(device), None if picked is None else picked.to(device)
    found, covered = front_depth(splats, CAMERA, mask, shares=shares, backend=backend)
    exact = leaf(CLOUD, torch.float64)
    wanted, expected = front_depth(exact, CAMERA, picked, shares=shares, backend="reference")
    assert (covered.cpu() - expected).abs().max() < 1e-5 and expected.max() > 0.7
    off = (found.cpu() - wanted).abs()
    assert off.max() < 1e-3


@pytest.mark.parametrize("backend", ANY)
@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], [0.5, 0.0, 1.0], [-0.3, 0.6, 1.0]])
def test_of_a_tilted_disc_each_pixel_has_a_depth_of_its_own(backend: Backend, normal: list[float]):
    splats = wall(3.0, normal).to(device_of(backend))
    depths, covered = (each.cpu() for each in front_depth(splats, CAMERA, backend=backend))
    y, x = torch.meshgrid(torch.arange(52) + 0.5, torch.arange(70) + 0.5, indexing="ij")
    rays = torch.stack([(x - 33) / 60, (y - 25) / 70, torch.ones_like(x)], dim=2)
    expected = 3.0 * normal[2] / (rays @ torch.tensor(normal))
    assert (middle(covered) > 0.8).all()
    # An affine camera per Gaussian: exact in its centre, and near it to second order
    assert (middle(depths) - middle(expected)).abs().max() < 0.05
    slopes = middle(depths)[4:6, 4:6] - middle(expected)[4:6, 4:6]
    assert slopes.abs().max() < 5e-3


@pytest.mark.parametrize("backend", ANY)
def test_haze_does_not_move_the_surface_behind_it(backend: Backend):
    flat = [0.0, 0.0, 1.0]
    for haze, expected in ((0.05, 3.0), (0.3, 1.0 * 2 / 3 + 3.0 / 3), (0.45, 1.0)):
        logit = math.log(haze / (1 - haze))
        splats = Splats.cat([wall(1.0, flat, logit), wall(3.0, flat), wall(5.0, flat)])
        splats = splats.to(device_of(backend))
        depths, _ = front_depth(splats, CAMERA, backend=backend)
        centre = depths[24:26, 32:34].cpu()  # where the haze has its full opacity
        assert (centre - expected).abs().max() < 0.05


def test_others_only_hide():
    mask = torch.arange(3) == 1
    flat = [0.0, 0.0, 1.0]
    splats = Splats.cat([wall(1.0, flat, 0.0), wall(3.0, flat), wall(5.0, flat)])
    depths, covered = front_depth(splats, CAMERA, mask)
    assert (middle(depths) - 3.0).abs().max() < 1e-4
    assert torch.equal(covered, coverage(splats, CAMERA, mask))
    assert 0.4 < float(middle(covered).mean()) < 0.6
    nothing = front_depth(splats, CAMERA, torch.zeros_like(mask))
    assert not any(each.any() for each in nothing)


def test_the_far_side_of_an_object_does_not_move_its_near_side():
    flat = [0.0, 0.0, 1.0]
    splats = Splats.cat([wall(3.0, flat, 1.0), wall(3.02, flat, 1.0), wall(4.0, flat)])
    shown = near_side_depth_map(splats, CAMERA, 1.2)
    assert (middle(shown.depths) - 3.0).abs().max() < 0.02
    assert torch.equal(shown.coverage, coverage(splats, CAMERA))


def near_side(splats: Splats, camera: Cameras) -> DepthMap:
    return near_side_depth_map(splats, camera, 2 * RADIUS)


@pytest.mark.parametrize(("surface", "pixels"), [(depth_map, 1.0), (near_side, 1.5)])
def test_a_ball_is_found_within_a_pixel(
    surface: Callable[[Splats, Cameras], DepthMap], pixels: float
):
    shown = surface(ball(), CAMERA)
    found = surface_points(shown, torch.rand(52, 70, 3), grazing=0.3)
    assert len(found.points) > 500 and (found.coverage > COVERED).all()
    assert ((found.points.norm(dim=1) - RADIUS).abs() < pixels * found.sizes).all()
    outward = F.normalize(found.points, dim=1)
    degrees = torch.rad2deg((found.normals * outward).sum(dim=1).clamp(-1, 1).acos())
    assert float(degrees.median()) < 5
    assert ((CAMERA.positions - found.points) * found.normals).sum(dim=1).min() > 0


def test_moving_and_enlarging_all_moves_the_surface_along():
    scale, shift = 2.5, torch.tensor([3.0, -1.0, 0.5])
    turn, _ = torch.linalg.qr(torch.tensor([[0.2, 1.0, 0.1], [-1.0, 0.3, 0.4], [0.3, 0.1, 1.0]]))
    turn = turn * torch.linalg.det(turn)
    w = 0.5 * (1 + turn.trace()).sqrt()
    skew = torch.stack([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    a, own = torch.cat([w[None], skew / (4 * w)]), CLOUD.quats
    real = a[0] * own[:, :1] - own[:, 1:] @ a[1:, None]
    rest = a[0] * own[:, 1:] + own[:, :1] * a[1:]
    rest = rest + torch.linalg.cross(a[1:].expand_as(rest), own[:, 1:])
    moved = replace(
        CLOUD,
        means=scale * CLOUD.means @ turn.T + shift,
        quats=torch.cat([real, rest], dim=1),
        scales=CLOUD.scales + math.log(scale),
    )
    viewmats = CAMERA.viewmats.clone()
    viewmats[0, :3, :3] = CAMERA.viewmats[0, :3, :3] @ turn.T
    viewmats[0, :3, 3] = scale * CAMERA.viewmats[0, :3, 3] - viewmats[0, :3, :3] @ shift
    there = replace(CAMERA, viewmats=viewmats)
    before, after = depth_map(CLOUD, CAMERA), depth_map(moved, there)
    off = (after.depths - scale * before.depths).abs()
    assert off.quantile(0.98) < 1e-3 and before.depths.max() > 1
    shown = before.coverage > COVERED
    wanted = scale * before.points @ turn.T + shift
    assert (after.points - wanted)[shown].norm(dim=1).quantile(0.98) < 1e-2


def test_pixels_that_show_nothing_have_no_depth():
    pixels, weights = torch.tensor([0, 0, 2]), torch.tensor([0.1, 0.6, 0.3])
    image = mean_depths(pixels, weights, torch.tensor([4.0, 5.0, 6.0]), 4, (0.0, 0.5))
    first = (0.1 * 4 + 0.25 * 5) / 0.35
    assert torch.allclose(image, torch.tensor([[first, 0.7], [0, 0], [6.0, 0.3], [0, 0]]))


def test_voxels_hold_the_means_of_their_points():
    points = torch.tensor([[0.1, 0.1, 0.1], [0.3, 0.1, 0.1], [5.0, 0.0, -3.0]])
    counts, (means, values) = average_in_voxels(1.0, points, 2 * points)
    order = counts.argsort(descending=True)
    assert counts[order].tolist() == [2, 1]
    assert torch.allclose(means[order], torch.stack([points[:2].mean(dim=0), points[2]]))
    assert torch.allclose(values, 2 * means)


PIXEL, SIDE = 0.1, 60  # the size of a pixel, and pixels of a flat side


def flat_side() -> tuple[Tensor, Tensor]:
    """Places, and the normal of each."""
    axis = PIXEL * torch.arange(float(SIDE))
    x, y = torch.meshgrid(axis, axis, indexing="ij")
    points = torch.stack([x, y, torch.zeros_like(x)], dim=2).flatten(0, 1)
    return points, torch.tensor([0.0, 0.0, 1.0]).expand(len(points), 3)


def test_a_flat_side_beyond_the_silhouettes_is_moved_inwards():
    points, normals = flat_side()
    solid = torch.ones(len(points), dtype=torch.bool)

    def outside(points: Tensor) -> Tensor:
        """In one half of the side silhouettes are two pixels lower, in the last rows more."""
        x = points[:, 0] / (PIXEL * SIDE)
        lower = torch.where(x > 0.8, SURFACE_PULLS + 1.0, torch.where(x > 0.45, 1.5, -1.0))
        return points[:, 2] > -lower * PIXEL

    moved = points.clone()
    kept = project_into_silhouettes(moved, normals, solid, PIXEL, outside)
    x = points[:, 0] / (PIXEL * SIDE)
    lower = (x > 0.45) & (x <= 0.8)
    assert kept[x <= 0.45].all() and torch.equal(moved[x <= 0.45], points[x <= 0.45])
    far = lower & (
        x > 0.45 + (SURFACE_BESIDE + 1) / SIDE
    )  # nearer ones have kept points beside them
    assert kept[far].all() and (moved[far, 2] + 2 * PIXEL).abs().max() < 1e-5
    assert not kept[x > 0.8].any(), "so far outside is no surface"


def test_what_is_less_solid_fills_holes_alone():
    points, normals = flat_side()
    middle = PIXEL * torch.tensor([SIDE / 3, SIDE / 2, 0])
    far = (points - middle).norm(dim=1) / PIXEL
    beside = points[:, 0] / PIXEL > SIDE - SURFACE_HOLE  # as at a soft edge

    def kept(solid: Tensor) -> Tensor:
        return project_into_silhouettes(
            points.clone(), normals, solid, PIXEL, lambda points: torch.zeros(len(points)).bool()
        )

    hole = far < 2 * SURFACE_HOLE
    found = kept(~hole & ~beside)
    assert found[~hole & ~beside].all()
    assert found[far < 2 * SURFACE_HOLE - SURFACE_BESIDE - 1].all()
    assert not found[beside].any()
    assert not kept(torch.zeros(len(points)).bool()).any(), "smoke has no surface"
