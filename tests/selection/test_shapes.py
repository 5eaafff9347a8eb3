import pytest
import torch

from balls import BALL_RADIUS, BALLS, CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.rasterize import rasterize
from stylesplat.selection.pick import pick
from stylesplat.selection.shapes import in_box, in_sphere, surface_point

RED = pick(SPLATS, object_id=3, remove_outliers=False)
CENTRE = torch.tensor(BALLS[3][0])


def test_a_box_and_a_sphere_around_a_ball_hold_it_alone():
    reach = 1.01 * BALL_RADIUS
    above = torch.tensor([0.0, 0.0, 0.01])  # the table lies at 0
    assert torch.equal(in_sphere(SPLATS, CENTRE + above, reach + 0.01) & RED, RED)
    box = in_box(SPLATS, CENTRE - reach, CENTRE + reach)
    assert torch.equal(box & RED, RED)
    others = pick(SPLATS, object_id=[7, 300], remove_outliers=False)
    assert not (box & others).any()


def test_surface_point_lies_on_what_shows():
    camera = CAMERAS[0]
    viewmat, K = camera.viewmats[0], camera.Ks[0]
    pixel = K @ (viewmat[:3, :3] @ CENTRE + viewmat[:3, 3])
    x, y = (pixel[:2] / pixel[2]).tolist()
    assert rasterize(SPLATS, camera)[1][0, int(y), int(x), 0] > 0.5
    point = surface_point(SPLATS, camera, (x, y))
    assert (point - CENTRE).norm() < 1.6 * BALL_RADIUS
    ahead = viewmat[:3, :3] @ point + viewmat[:3, 3]
    seen = K @ ahead
    assert (seen[:2] / seen[2] - torch.tensor([int(x) + 0.5, int(y) + 0.5])).norm() < 1e-3


def test_nothing_there():
    zero, one = torch.zeros(3), torch.ones(3)
    with pytest.raises(StyleSplatError, match=r"is empty\. Give the lower corner first"):
        in_box(SPLATS, one, zero)
    with pytest.raises(StyleSplatError, match="No Gaussian lies in the box from 50,50,50"):
        in_box(SPLATS, one * 50, one * 51)
    with pytest.raises(StyleSplatError, match="The splat reaches from -1"):
        in_sphere(SPLATS, one * 50, 1.0)
    with pytest.raises(StyleSplatError, match=r"radius 0\. Give more than 0"):
        in_sphere(SPLATS, one, 0.0)
    with pytest.raises(StyleSplatError, match=r"is outside 0000\.jpg, which is 48x36"):
        surface_point(SPLATS, CAMERAS[0], (48.0, 3.0))
    with pytest.raises(StyleSplatError, match=r"Nothing solid shows at 0,0 .* Choose another"):
        surface_point(SPLATS, CAMERAS[0], (0.0, 0.0))
