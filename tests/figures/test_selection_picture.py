from dataclasses import replace

import pytest
import torch

from balls import BALLS, CAMERAS, SPLATS
from stylesplat.figures.grid import CAPTION, MARGIN
from stylesplat.figures.sheets import OUTLINE, PANEL, THICKNESS, selection_picture
from stylesplat.scene.cameras import Cameras
from stylesplat.selection.pick import pick

RED = pick(SPLATS, object_id=3, remove_outliers=False)
BLUE = pick(SPLATS, object_id=300, remove_outliers=False)
GREEN = pick(SPLATS, object_id=7, remove_outliers=False)
HEIGHT = PANEL * 36 // 48


def drawn(picked: torch.Tensor, cameras: Cameras = CAMERAS) -> torch.Tensor:
    picture = selection_picture(SPLATS, cameras, picked)
    assert picture is not None
    return picture


def panel(picture: torch.Tensor, number: int) -> torch.Tensor:
    left = MARGIN + number * (PANEL + MARGIN)
    return picture[MARGIN : MARGIN + HEIGHT, left : left + PANEL].float()


def colored(panel: torch.Tensor, color: tuple[int, ...]) -> torch.Tensor:
    return (panel - torch.tensor(color)).abs().amax(dim=-1) < 40


@pytest.mark.parametrize(("picked", "channel"), [(RED, 0), (BLUE, 2)])
def test_what_is_picked_in_colour_and_all_else_grey(picked: torch.Tensor, channel: int):
    picture = drawn(picked)
    assert picture.shape == (2 * MARGIN + HEIGHT + CAPTION, MARGIN + 3 * (PANEL + MARGIN), 3)
    for number in range(3):
        view = panel(picture, number)
        outline = colored(view, OUTLINE)
        vivid = view[((view.amax(dim=-1) - view.amin(dim=-1)) > 90) & ~outline]
        assert len(vivid) > 400 and outline.sum() > 100
        hues = vivid.argmax(dim=-1)
        assert (hues == channel).float().mean() > 0.9  # but for where the outline is blended
        grey = view.amax(dim=-1) - view.amin(dim=-1) < 20
        assert 0.3 < grey.float().mean() < 0.98


def test_blue_is_what_takes_no_paint():
    """A few Gaussians of another ball, which they do not cover."""
    few = RED.clone()
    few[GREEN.nonzero()[:8, 0]] = True
    where = (drawn(few).float() - drawn(RED).float())[..., 2] > 20
    assert where.sum() > 20
    red, green, blue = drawn(few)[where].float().mean(dim=0)
    assert blue > 1.3 * max(red, green)


def test_the_outline_goes_round_the_object():
    view = panel(drawn(RED), 0)
    outline = colored(view, OUTLINE)
    vivid = (view.amax(dim=-1) - view.amin(dim=-1) > 90) & ~outline
    line, ball = outline.nonzero(), vivid.nonzero()
    before, after = ball.amin(dim=0) - line.amin(dim=0), line.amax(dim=0) - ball.amax(dim=0)
    assert (torch.cat([before, after]) >= -THICKNESS).all()  # its own blended pixels are vivid, too
    assert (torch.cat([before, after]) < 20).all()  # a tenth of its width, where its rim fades


def test_a_small_object_is_shown_from_close_by():
    small = replace(CAMERAS, Ks=CAMERAS.Ks.clone(), sizes=4 * CAMERAS.sizes)
    small.Ks[:, :2, 2] *= 4  # the same objects in a picture four times as long
    far, near = panel(drawn(RED, small), 0), panel(drawn(RED), 0)
    lengths = [colored(view, (230, 26, 26)).nonzero()[:, 1].float().std() for view in (far, near)]
    assert 0.5 < lengths[0] / lengths[1] < 2  # uncut, it would be a quarter
    assert colored(far, OUTLINE).any()


def test_fewer_views():
    assert drawn(RED, CAMERAS[:2]).shape[1] == MARGIN + 2 * (PANEL + MARGIN)
    nothing = torch.zeros_like(RED)
    nothing[0] = True
    inside = torch.tensor([BALLS[3][0]])
    splats = replace(
        SPLATS,
        means=torch.cat([inside, SPLATS.means[1:]]),
        scales=SPLATS.scales.index_fill(0, torch.tensor([0]), -6.0),
    )
    assert selection_picture(splats, CAMERAS, nothing) is None


def test_views_of_different_shapes_and_names():
    tall = replace(CAMERAS[:1], sizes=torch.tensor([[36, 48]]), names=("tall.jpg",))
    both = drawn(RED, tall + CAMERAS[2:3])
    assert both.shape == (2 * MARGIN + PANEL + CAPTION, 2 * MARGIN + PANEL + HEIGHT + MARGIN, 3)
    renamed = replace(CAMERAS, names=tuple("x" * 99 + name for name in CAMERAS.names))
    changed = (drawn(RED, renamed) != drawn(RED)).any(dim=-1).nonzero()
    assert changed[:, 0].min() >= MARGIN + HEIGHT, "names are below the pictures"
