import pytest
import torch

from scenes import box, cloud, figure, floaters, guitar, joined, reaches, room
from stylesplat.scene.content import content_of, extent_of


def test_a_thin_part_with_few_gaussians_is_content():
    corners = [-0.15, -0.05, 0.0, 0.15, 0.05, 1.0]
    assert reaches(content_of(guitar())) == pytest.approx(corners, abs=0.03)


def test_floaters_are_no_content_be_they_opaque_and_in_clumps():
    alone, among = content_of(figure()), content_of(joined(figure(), floaters()))
    assert reaches(among) == pytest.approx(reaches(alone), abs=0.03)
    assert len(among.others) > 450  # of 500; the others hang together with the figure


def test_walls_of_a_room_are_no_content_where_it_has_things_in_it():
    corners = [-0.5, -0.5, 0.0, 0.5, 0.5, 0.4]
    assert reaches(content_of(room())) == pytest.approx(corners, abs=0.05)


@pytest.mark.parametrize("count", [1, 2, 3, 19, 21, 40])
def test_a_few_gaussians_are_all_content(count: int):
    points = box(count, [0] * 3, [1] * 3)
    for splats in (cloud(points), cloud(0 * points), cloud(points, opacity=-9.0)):
        extent = content_of(splats).extent
        assert (extent.low < extent.high).all()
        assert (splats.means >= extent.low).all() or count > 20
        assert (splats.means <= extent.high).all() or count > 20


def test_the_box_around_an_object():
    splats = joined(figure(), floaters())
    picked = torch.arange(len(splats)) < 4000
    extent = extent_of(splats, picked)
    assert extent.size.tolist() == pytest.approx([0.5, 0.3, 1.8], abs=0.03)
    assert extent.centre.tolist() == pytest.approx([0.0, 0.0, 0.9], abs=0.02)
