from dataclasses import replace

import pytest
import torch

from balls import (
    CAMERAS,
    CENTRE,
    COUNT,
    LIGHT,
    PICKED,
    SPLATS,
    WAYS,
    ball,
    cropped,
    dense_ball,
    enlarged,
)
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.weights import coverage
from stylesplat.scene.projection import project
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.views import find_boxes, typical_length, views_all_over, windows


def test_boxes_hold_the_object():
    boxes = find_boxes(SPLATS, CAMERAS, ball(0))
    assert [box.camera.names[0] for box in boxes] == list(CAMERAS.names)
    for box in boxes:
        seen = coverage(SPLATS, box.camera, ball(0)) > 0.5
        (x0, y0), (x1, y1) = box.low.int().tolist(), box.high.int().tolist()
        assert seen[y0:y1, x0:x1].sum() == seen.sum() > 0
        assert box.length == max(x1 - x0, y1 - y0)
    lengths = [box.length for box in boxes]
    assert min(lengths) <= typical_length(boxes) <= max(lengths)
    behind = replace(
        CAMERAS[0], viewmats=CAMERAS[0].viewmats * torch.tensor([1, 1, -1, 1])[:, None]
    )
    assert find_boxes(SPLATS, behind, ball(0)) == []


def test_a_photo_of_many_pixels_is_looked_at_like_the_others():
    boxes = find_boxes(SPLATS, CAMERAS, ball(0))
    large = enlarged(CAMERAS[:1], 10)
    sizes, Ks = CAMERAS.sizes.clone(), CAMERAS.Ks.clone()
    sizes[0], Ks[0] = large.sizes[0], large.Ks[0]
    mixed = find_boxes(SPLATS, replace(CAMERAS, sizes=sizes, Ks=Ks), ball(0))
    assert [box.camera.size for box in mixed] == [box.camera.size for box in boxes]
    assert mixed[0].length == pytest.approx(boxes[0].length, abs=2)


@pytest.mark.parametrize("zoom", [1.0, 2.5])
def test_cells_are_those_that_the_object_covers(network: FeatureNetwork, zoom: float):
    boxes = find_boxes(SPLATS, CAMERAS[3:5], ball(2))
    views, fine = (
        cropped(SPLATS, boxes, ball(2), network, block=block, zoom=zoom) for block in (2, 1)
    )
    assert len(views) == len(fine) == 2
    for view in fine:
        assert torch.equal(view.cells, coverage(SPLATS, view.camera, ball(2)) > 0.5)
    for view in views:
        image, _, _ = rasterize(SPLATS, view.camera)
        assert view.cells.shape == network(image[0], [2])[0].shape[:2]
        seen = coverage(SPLATS, view.camera, ball(2))
        coarse = view.cells.repeat_interleave(2, 0).repeat_interleave(2, 1)
        h, w = coarse.shape
        assert seen[:h, :w][coarse].mean() > 0.5


def test_cuts_include_all_that_the_features_depend_on(network: FeatureNetwork):
    cells = network.cells(2)
    box = find_boxes(SPLATS, CAMERAS[:1], ball(2))
    (view,) = cropped(SPLATS, box, ball(2), network)
    whole, _, _ = rasterize(SPLATS, CAMERAS[:1])
    x, y = (CAMERAS.Ks[0, :2, 2] - view.camera.Ks[0, :2, 2]).int().tolist()
    width, height = view.camera.size
    part = whole[0, y : y + height, x : x + width]
    torn = whole[0].clone()
    torn[:y], torn[y + height :], torn[:, :x], torn[:, x + width :] = 9, 9, 9, 9
    assert x + y > 0 and width < 48
    rows, columns = view.cells.nonzero(as_tuple=True)
    aligned = torn[y % cells.stride :, x % cells.stride :]
    around = network(aligned, [2])[0][rows + y // cells.stride, columns + x // cells.stride]
    torch.testing.assert_close(network(part, [2])[0][rows, columns], around)


def test_windows_are_parts_of_boxes_with_the_object_inside(network: FeatureNetwork):
    boxes = find_boxes(SPLATS, CAMERAS[:3], ball(0))
    side = min(box.length for box in boxes) / 2
    parts = windows(boxes, side, 7, torch.Generator().manual_seed(0))
    names = [part.camera.names[0] for part in parts]
    assert sorted(names.count(box.camera.names[0]) for box in boxes) == [2, 2, 3]
    for part in parts:
        (box,) = (box for box in boxes if box.camera.names == part.camera.names)
        assert (part.low >= box.low).all() and (part.high <= box.high).all()
        assert part.length <= side
    (view, *_) = cropped(SPLATS, parts, ball(0), network, block=1, zoom=4.0)
    inside = (view.cells.sum(dim=1) > 0).sum()
    assert 0 < inside <= 4 * side + 2, "features of the margin are not the part's"
    (part,) = windows(boxes[:1], 1000.0, 1, torch.Generator().manual_seed(0))
    assert torch.equal(part.low, boxes[0].low) and torch.equal(part.high, boxes[0].high)


def test_views_are_from_all_sides_though_most_are_from_one():
    splats, every = dense_ball(LIGHT)[PICKED], torch.ones(COUNT, dtype=torch.bool)
    rows = [*[0] * 20, 4, *[0] * 20]
    cameras = replace(CAMERAS[rows], names=tuple(map(str, range(len(rows)))))
    boxes = find_boxes(splats, cameras, every)
    chosen = views_all_over(boxes, 4)
    assert [box.camera.names[0] for box in chosen] == ["5", "15", "20", "25", "35"]
    assert views_all_over(boxes, 99) == boxes
    assert views_all_over([], 3) == []


def test_windows_on_a_surface_show_all_of_it_whatever_most_views_see():
    splats, every = dense_ball(LIGHT)[PICKED], torch.ones(COUNT, dtype=torch.bool)
    cameras = replace(CAMERAS[[0, 0, 0, 4]], names=("a", "b", "c", "behind"))
    boxes = find_boxes(splats, cameras, every)
    surface = 0.4 * WAYS + CENTRE, WAYS
    side = min(box.length for box in boxes) / 4
    parts = windows(boxes, side, 200, torch.Generator().manual_seed(0), surface)
    names = [part.camera.names[0] for part in parts]
    assert names.count("behind") > 200 / 3, "a quarter of the views, and more of the surface"
    assert all(part.length < 1.001 * side for part in parts)


def test_few_windows_leave_no_place_out():
    """Of a ball seen from four sides, by windows whose area is twice that of the boxes."""
    splats, every = dense_ball(LIGHT)[PICKED], torch.ones(COUNT, dtype=torch.bool)
    boxes = find_boxes(splats, CAMERAS[:4], every)
    side = min(box.length for box in boxes) / 3
    surface = 0.4 * WAYS + CENTRE, WAYS
    parts = windows(boxes, side, 2 * 4 * 9, torch.Generator().manual_seed(0), surface)
    shown, seen = torch.zeros(COUNT, dtype=torch.bool), torch.zeros(COUNT, dtype=torch.bool)
    for window in [*parts, *boxes]:
        pixels, _ = project(surface[0], window.camera)
        facing = ((window.camera.positions - surface[0]) * WAYS).sum(dim=1) > 0.5
        inside = ((pixels >= window.low) & (pixels < window.high)).all(dim=1) & facing
        seen |= inside
        if not any(window is box for box in boxes):
            shown |= inside
    assert seen.sum() > COUNT / 2 and shown[seen].float().mean() > 0.99
