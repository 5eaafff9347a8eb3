"""What holds an object's large shapes while its strokes get their edges."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.scene.projection import crop
from stylesplat.stylization.anchor import SIDE, Anchor
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.object_views import ObjectView, cut_views, find_boxes

PICKED = torch.arange(len(SPLATS)) < 200


@pytest.fixture(scope="module")
def view(network: FeatureNetwork) -> ObjectView:
    boxes = find_boxes(SPLATS, CAMERAS[:1], PICKED)
    return cut_views(SPLATS, boxes, PICKED, [network.cells(2)], zoom=2.0)[0]


def test_shapes_are_held_and_detail_is_free(view: ObjectView):
    anchor, image = Anchor(SPLATS), view.render(SPLATS)
    assert anchor.distance(view, image) == 0
    height, width = image.shape[:2]
    waves = torch.tensor([0.1, -0.1]).repeat(SIDE // 2)
    fine = waves.repeat(width // SIDE + 1)[:width].expand(height, width)[..., None]
    everywhere = anchor.distance(view, image + 0.1)
    assert anchor.distance(view, image + fine) < 0.2 * everywhere, "but for the contour"
    outside = torch.where(view.pixels[..., None], image, image + 0.1)
    assert anchor.distance(view, outside) == 0


def test_what_was_there_is_remembered_by_view(view: ObjectView):
    anchor, image = Anchor(SPLATS), view.render(SPLATS)
    anchor.distance(view, image)
    moved = replace(view, camera=replace(view.camera, Ks=view.camera.Ks * 1.01))
    anchor.distance(moved, image)
    assert len(anchor.known) == 2


def test_what_does_not_fit_is_not_remembered(view: ObjectView):
    image = view.render(SPLATS) + 0.1
    without, free = Anchor(SPLATS, room=0.0), Anchor(SPLATS)
    assert without.distance(view, image) == free.distance(view, image)
    assert not without.known and len(free.known) == 1


def test_parts_from_one_corner_on_are_told_apart(view: ObjectView):
    """As windows at a photo's border are, of which one may be smaller."""
    anchor, (width, height) = Anchor(SPLATS), view.camera.size
    anchor.distance(view, view.render(SPLATS))
    camera = crop(view.camera, (0, 0), (width - 2 * SIDE, height))
    smaller = replace(view, camera=camera, pixels=view.pixels[:, : -2 * SIDE], linear=None)
    assert anchor.distance(smaller, smaller.render(SPLATS)) == 0
    assert len(anchor.known) == 2
