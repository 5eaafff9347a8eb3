"""The balls at 96x72 pixels. Their rims are soft, and `render_labels` draws them about a pixel
narrower than colours do, so that masks of them cannot agree by more than 0.9 or so."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS, box_around, enlarged
from scenes import box, cloud
from stylesplat.errors import StyleSplatError
from stylesplat.imaging.similarity import mask_iou
from stylesplat.masks import box_propagation
from stylesplat.masks.box_propagation import Images, pick_in_boxes, propagate_boxes, view_images
from stylesplat.masks.grabcut import cut_box
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.weights import coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import render_labels

MARGIN = 2  # pixels between an object and its box


def photographed(splats: Splats, cameras: Cameras) -> Images:
    images = [rasterize(splats, cameras[row])[0][0] for row in range(len(cameras))]
    photos = [(255 * image.clamp(0, 1)).round().to(torch.uint8) for image in images]
    return view_images(splats, Capture(cameras=cameras, photos=photos))


LARGE = enlarged(CAMERAS, 2)
LABELS = [render_labels(SPLATS, LARGE[row]) for row in range(len(LARGE))]


@pytest.fixture(scope="module")
def seen() -> Images:
    return photographed(SPLATS, LARGE)


@pytest.mark.parametrize(
    ("id", "row", "bound"),
    [(3, 1, 0.75), (7, 5, 0.7), (300, 3, 0.7)],  # measured: 0.82, 0.77 and 0.79
)
def test_one_box_gives_masks_in_all_views(seen: Images, id: int, row: int, bound: float):
    truth = [labels == id for labels in LABELS]
    found = propagate_boxes(SPLATS, LARGE, seen, [(row, box_around(truth[row], MARGIN))])
    agreement = [mask_iou(*each) for each in zip(found, truth, strict=True)]
    assert min(agreement) > bound, agreement


def test_the_same_box_gives_the_same_masks(seen: Images, monkeypatch: pytest.MonkeyPatch):
    """Also with other numbers of threads, which GrabCut's random numbers must not notice."""
    places = [(1, box_around(LABELS[1] == 3, MARGIN))]
    first = propagate_boxes(SPLATS, LARGE, seen, places)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)
    again = propagate_boxes(SPLATS, LARGE, seen, places)
    assert all(torch.equal(*each) for each in zip(first, again, strict=True))


def test_boxes_in_two_photos(seen: Images):
    truth = [labels == 3 for labels in LABELS]
    places = [(row, box_around(truth[row], MARGIN)) for row in (0, 4)]
    found = propagate_boxes(SPLATS, LARGE, seen, places)
    assert min(mask_iou(*each) for each in zip(found, truth, strict=True)) > 0.7  # measured: 0.76
    for row, place in places:
        assert torch.equal(found[row], cut_box(seen.with_depth(row), place, "")[1]), "as it was cut"


def test_the_middle_of_a_cut_out_that_the_photo_cuts_off_is_not_its_corner(
    monkeypatch: pytest.MonkeyPatch,
):
    clicks, everything = list[tuple[float, float]](), torch.ones(len(SPLATS), dtype=torch.bool)

    def pick(splats: Splats, cameras: Cameras, places: list[tuple[Cameras, tuple[float, float]]]):
        clicks.extend(place for _, place in places)
        return everything

    monkeypatch.setattr(box_propagation, "pick_clicked", pick)
    width, height = LARGE[0].size
    corner = torch.zeros(height, width, dtype=torch.bool)
    corner[:40, :30] = True
    pick_in_boxes(SPLATS, LARGE, {0: corner}, {0: corner})
    (x, y) = clicks[0]
    assert abs(x - 15) < 1 and 14 < y < 26


def test_where_an_object_does_not_show_its_mask_is_empty():
    away = LARGE.viewmats[[0]].clone()
    away[:, [0, 2]] *= -1  # turned around
    cameras = replace(
        LARGE[[0, 1, 2]],
        viewmats=torch.cat([LARGE.viewmats[[0, 1]], away]),
        names=("0.jpg", "1.jpg", "away.jpg"),
    )
    found = propagate_boxes(
        SPLATS, cameras, photographed(SPLATS, cameras), [(1, box_around(LABELS[1] == 3, MARGIN))]
    )
    assert [bool(mask.any()) for mask in found] == [True, True, False]


def test_the_photo_of_a_bad_box_is_named(seen: Images):
    background = (0.0, 60.0, 10.0, 70.0)  # black, as all around
    with pytest.raises(StyleSplatError, match=r"box in 0001\.jpg holds looks like"):
        propagate_boxes(SPLATS, LARGE, seen, [(1, background)])


def test_legs_grow_to_their_ends(monkeypatch: pytest.MonkeyPatch):
    """A leg under a body, whose foot is not picked: it comes back in several rounds."""
    heights = torch.linspace(-0.8, 0.0, 80)
    leg = torch.stack([0 * heights, 0 * heights, heights], dim=1)
    body = box(600, [-0.4, -0.4, 0], [0.4, 0.4, 0.5])
    toy = cloud(torch.cat([body, leg]), sigma=0.06, opacity=6.0)
    shown = toy.means[:, 2] > -0.6
    monkeypatch.setattr(box_propagation, "pick_in_boxes", lambda *_: (shown, torch.inf))
    found = propagate_boxes(toy, LARGE, photographed(toy, LARGE), [(0, (20.0, 10.0, 76.0, 68.0))])
    for row, mask in enumerate(found):
        truth, picked = (coverage(toy, LARGE[row], of) > 0.5 for of in (shown | True, shown))
        foot = truth & ~picked
        foot[: int(picked.nonzero()[:, 0].max())] = False
        assert (mask & foot).sum() > 0.7 * foot.sum() > 0


def test_what_is_thin_does_not_vanish(monkeypatch: pytest.MonkeyPatch):
    heights = torch.linspace(-0.5, 0.5, 60)
    rod = cloud(torch.stack([0 * heights, 0 * heights, heights], dim=1), sigma=0.03, opacity=6.0)
    monkeypatch.setattr(box_propagation, "pick_in_boxes", lambda *_: (heights > -0.2, torch.inf))
    found = propagate_boxes(rod, LARGE, photographed(rod, LARGE), [(0, (44.0, 20.0, 52.0, 60.0))])
    for row, mask in enumerate(found):
        assert mask_iou(mask, coverage(rod, LARGE[row], heights > -0.2) > 0.5) > 0.9
