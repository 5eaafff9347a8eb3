import numba
import numpy as np
import pytest
import torch

from stylesplat.demo.cloud import surface_points
from stylesplat.demo.solids import BOUNDS, NAMES, distance
from stylesplat.demo.still_life import OBJECT_NAMES, View, arrange, dome_cameras, photograph
from stylesplat.demo.surroundings import BACKDROP_RADIUS, TABLE_RADIUS
from stylesplat.demo.tracer import HIT
from stylesplat.scene.projection import pixel_centres, project, unproject

CAMERAS = dome_cameras(24, 64, 48)[[0, 1, 6, 12]]


@pytest.fixture(scope="module")
def views() -> list[View]:
    return list(photograph(CAMERAS, seed=0))


@numba.njit
def signed_distance(object_id, point):
    return distance(object_id, point)  # only kernels can call it


def object_distances(points: np.ndarray, layout: np.ndarray) -> np.ndarray:
    """Signed distance from each world point to each object."""
    result = np.empty((len(points), len(NAMES)))
    for i, (x, y, c, s, _) in enumerate(layout):
        px, py = points[:, 0] - x, points[:, 1] - y
        local = np.column_stack([c * px + s * py, c * py - s * px, points[:, 2]])
        result[:, i] = [signed_distance(i + 1, tuple(p)) for p in local.tolist()]
    return result


def test_the_same_seed_gives_the_same_pixels(views: list[View]):
    for one, other in zip(views, photograph(CAMERAS, seed=0), strict=True):
        assert torch.equal(one.photo, other.photo)
        assert torch.equal(one.labels, other.labels)
        assert torch.equal(one.depth, other.depth)


def test_another_seed_gives_another_arrangement(views: list[View]):
    other = next(photograph(CAMERAS[:1], seed=1))
    assert not torch.equal(views[0].labels, other.labels)
    assert (views[0].photo.int() - other.photo.int()).abs().float().mean() > 2


def test_every_object_is_seen(views: list[View]):
    seen = torch.cat([v.labels.flatten() for v in views]).unique().tolist()
    assert seen == [0, *OBJECT_NAMES]


def test_photos_have_light_and_shade(views: list[View]):
    for view in views:
        assert view.photo.float().std() > 30
        assert (view.photo.amax(-1) == 255).float().mean() < 0.02  # hardly any burnt-out pixels


def surface(view: View, row: int) -> torch.Tensor:
    """Where in the world the pixels of a view lie."""
    return unproject(pixel_centres(64, 48), view.depth.flatten(), CAMERAS[row])


def test_unprojected_depth_projects_back_to_its_pixel(views: list[View]):
    for i, view in enumerate(views):
        pixels, depths = project(surface(view, i), CAMERAS[i])
        # float32 at a distance of 10
        torch.testing.assert_close(pixels, pixel_centres(64, 48), atol=1e-3, rtol=0)
        torch.testing.assert_close(depths, view.depth.flatten(), atol=1e-4, rtol=0)


def test_depth_lands_on_the_surface_that_the_label_names(views: list[View]):
    layout = arrange(0)
    for i, view in enumerate(views):
        points = surface(view, i).double().numpy()
        labels = view.labels.flatten().numpy()
        on_object = labels > 0
        distances = object_distances(points[on_object], layout)
        own = distances[np.arange(len(distances)), labels[on_object] - 1]
        assert np.abs(own).max() < HIT + 1e-5  # the tracer's tolerance and float32 rounding
        assert (distances.argmin(axis=1) == labels[on_object] - 1).mean() > 0.99
        x, y, z = points[~on_object].T
        on_table = (np.abs(z) < 1e-5) & (np.hypot(x, y) < TABLE_RADIUS)
        on_rim = np.abs(np.hypot(x, y) - TABLE_RADIUS) < 1e-4
        on_backdrop = np.abs(np.linalg.norm(points[~on_object], axis=1) - BACKDROP_RADIUS) < 1e-4
        assert (on_table | on_rim | on_backdrop).all()


def test_a_point_has_the_same_label_in_every_view_that_sees_it(views: list[View]):
    for i, j in ((0, 1), (0, 3), (3, 1)):
        pixels, depths = project(surface(views[i], i), CAMERAS[j])
        columns, rows = pixels.floor().long().unbind(-1)
        inside = (columns >= 0) & (columns < 64) & (rows >= 0) & (rows < 48)
        columns, rows = columns[inside], rows[inside]
        visible = (views[j].depth[rows, columns] - depths[inside]).abs() < 0.02
        agree = views[i].labels.flatten()[inside] == views[j].labels[rows, columns]
        assert visible.sum() > 300
        assert agree[visible].float().mean() > 0.98  # a pixel straddles two objects now and then


@pytest.mark.parametrize("seed", range(3))
def test_objects_stand_apart_and_inside_their_bounds(seed: int):
    layout = arrange(seed)
    axis = np.linspace(-1.4, 1.4, 57)
    grid = np.stack(np.meshgrid(axis, axis, np.linspace(0.02, 1.3, 27)), axis=-1).reshape(-1, 3)
    inside = object_distances(grid, layout) < 0
    assert inside.any(axis=0).all()
    assert inside.sum(axis=1).max() == 1
    for i, (x, y, *_) in enumerate(layout):
        offsets = grid[inside[:, i]] - (x, y, BOUNDS[i, 0])
        assert np.linalg.norm(offsets, axis=1).max() < BOUNDS[i, 1]


@pytest.mark.parametrize("object_id", OBJECT_NAMES)
def test_distances_never_overstep(object_id: int):
    """Outside, the field changes along any segment by no more than the way gone."""
    rng = np.random.default_rng(object_id)
    starts = rng.uniform((-0.7, -0.7, 0.0), (0.7, 0.7, 1.2), (5000, 3))
    ends = starts + rng.normal(0, 0.004, starts.shape)
    fields = np.array(
        [[signed_distance(object_id, tuple(p)) for p in q.tolist()] for q in (starts, ends)]
    )
    slopes = np.abs(fields[0] - fields[1]) / np.linalg.norm(ends - starts, axis=1)
    assert slopes[(fields > 0).all(axis=0)].max() < 1.03  # the ball's seams, where it is harmless


def test_cameras_look_at_the_middle_upright_from_two_heights():
    cameras = dome_cameras(12, 64, 48)
    middle = torch.tensor([[-0.03, 0.0, 0.38]])
    for i in range(12):
        pixels, _ = project(middle, cameras[i])
        torch.testing.assert_close(pixels, torch.tensor([[32.0, 24.0]]), atol=1e-3, rtol=0)
        above, _ = project(middle + torch.tensor([0.0, 0.0, 0.5]), cameras[i])
        assert above[0, 1] < 20  # up in the world is up in the photo
    heights = cameras.positions[:, 2]
    assert heights[:6].max() < heights[6:].min()


def test_surface_points_lie_near_what_the_views_see(views: list[View]):
    points, colors = surface_points(CAMERAS, views, 400, seed=5)
    assert points.shape == (400, 3) and colors.shape == (400, 3)
    pixels, depths = project(points[:100], CAMERAS[0])  # the first view's share
    columns, rows = pixels.floor().long().clamp(min=0).unbind(-1)
    seen = views[0].depth[rows.clamp(max=47), columns.clamp(max=63)]
    assert ((seen - depths).abs() / depths < 0.01).float().mean() > 0.8
    again, _ = surface_points(CAMERAS, views, 400, seed=5)
    assert torch.equal(points, again)
