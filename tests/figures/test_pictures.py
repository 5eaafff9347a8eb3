import math
from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.figures.pictures import identity_colors, label_colors, render_pictures
from stylesplat.rendering.weights import expected_depth
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import pick, render_labels

IMAGES = ["color", "identities", "depth", "object"]
GREEN = pick(SPLATS, object_id=7)


@pytest.mark.parametrize("what", IMAGES)
def test_every_picture_has_the_size_of_its_camera(what):
    cameras = CAMERAS[:2]
    cameras = replace(cameras, sizes=torch.tensor([[48, 36], [40, 30]]))
    shapes = [tuple(p.shape) for p in render_pictures(SPLATS, cameras, what, picked=GREEN)]
    assert shapes == [(36, 48, 3), (30, 40, 3)]


def test_labels_are_ids():
    (labels,) = render_pictures(SPLATS, CAMERAS[3], "labels")
    assert torch.equal(labels, render_labels(SPLATS, CAMERAS[3]))
    (colors,) = render_pictures(SPLATS, CAMERAS[3], "label-colors")
    assert torch.equal(colors, label_colors(labels))
    colors = label_colors(torch.arange(100)[None])[0]
    assert (colors[0] == 0).all() and len(colors.unique(dim=0)) == 100


def test_identity_colors_tell_objects_apart():
    colors = identity_colors(SPLATS)
    rows = [0, 200, 280, 360]  # the first Gaussian of each class
    assert torch.cdist(colors[rows], colors[rows]).fill_diagonal_(1).min() > 0.3
    assert colors.min() >= 0 and colors.max() <= 1


def test_depth_is_brighter_when_nearer_and_white_where_nothing_is():
    (picture,) = render_pictures(SPLATS, CAMERAS[2], "depth")
    luma = picture.float() @ torch.tensor([0.2126, 0.7152, 0.0722])
    assert (picture[0] == 255).all()
    assert luma[18, 23] > luma[6, 23] + 20  # ball 3 stands in front of ball 7


@pytest.mark.parametrize("what", IMAGES)
def test_transparent_pictures_are_the_same_on_any_background(what):
    """Straight alpha: what is composited later is what would have been rendered."""

    def picture(background: str) -> torch.Tensor:
        (found,) = render_pictures(SPLATS, CAMERAS[0], what, picked=GREEN, background=background)
        return found.float()

    cut = picture("transparent")
    colors, alpha = cut[..., :3], cut[..., 3:] / 255
    assert 0 < alpha.mean() < 0.9 and ((alpha > 0.1) & (alpha < 0.9)).any()
    for name, color in (("black", 0), ("white", 255)):
        expected = picture(name)
        assert (colors * alpha + color * (1 - alpha) - expected).abs().max() <= 1.51  # roundings
    # At the rim colours are as bright as within: no dark fringe
    if what == "object":
        rim, inside = (alpha[..., 0] > 0.1) & (alpha[..., 0] < 0.5), alpha[..., 0] > 0.9
        assert colors[rim].amax(dim=1).mean() > 0.8 * colors[inside].amax(dim=1).mean()


def test_depths_in_world_units():
    (depths,) = render_pictures(SPLATS, CAMERAS[2], "depth-float")
    expected, alphas = expected_depth(SPLATS, CAMERAS[2])
    assert (depths[alphas < 0.5] == 0).all() and (alphas >= 0.5).any()
    assert torch.equal(depths[alphas >= 0.5], expected[alphas >= 0.5])
    camera = replace(CAMERAS[2], viewmats=CAMERAS[2].viewmats.clone())
    camera.viewmats[:, :3, 3] *= 2
    larger = replace(SPLATS, means=2 * SPLATS.means, scales=SPLATS.scales + math.log(2))
    (twice,) = render_pictures(larger, camera, "depth-float")
    torch.testing.assert_close(twice, 2 * depths, rtol=1e-3, atol=1e-3)


def test_the_colour_of_a_background():
    (picture,) = render_pictures(SPLATS, CAMERAS[0], "object", picked=GREEN, background="#ff0033")
    assert picture[0, 0].tolist() == [255, 0, 51]


PLAIN = replace(SPLATS, identities=None, classifier=None)
BEHIND = replace(SPLATS, means=SPLATS.means + 99 * CAMERAS[0].positions)


@pytest.mark.parametrize(
    ("splats", "what", "background", "message"),
    [
        (SPLATS, "colour", None, r"Choose color, labels, .*object:NAME"),
        (SPLATS, "object", None, r"Choose color, labels, .*object:NAME"),
        (PLAIN, "labels", None, "no identities"),
        (PLAIN, "identities", None, "no identities"),
        (SPLATS, "labels", "white", "labels has no background"),
        (SPLATS, "depth-float", "white", "depth-float has no background"),
        (SPLATS, "color", "reddish", "#rrggbb"),
        (BEHIND, "depth", None, "No Gaussian lies in front"),
    ],
)
def test_pictures_that_cannot_be(splats: Splats, what: str, background: str | None, message: str):
    with pytest.raises(StyleSplatError, match=message):
        render_pictures(splats, CAMERAS[0], what, background=background)
