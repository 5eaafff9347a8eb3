import torch

from balls import CAMERAS, SPLATS
from painted_balls import BLUE, GREEN, RED
from stylesplat.figures.quiet_cut import quiet_cut
from stylesplat.rendering.shares import coverage


def covered(row: int, picked: torch.Tensor, place: float) -> float:
    """What a line cuts of an object."""
    return float((coverage(SPLATS, CAMERAS[row], picked)[:, int(place * 48)] > 0.5).sum())


def test_between_two_objects():
    place = quiet_cut(SPLATS, CAMERAS[0], [RED, GREEN])
    assert 0.35 < place < 0.65 and covered(0, RED | GREEN, place) == 0


def test_beside_a_single_one():
    assert covered(0, BLUE, quiet_cut(SPLATS, CAMERAS[0], [BLUE])) == 0


def test_nothing_in_the_picture_is_cut_in_the_middle():
    assert quiet_cut(SPLATS, CAMERAS[0], [torch.zeros_like(RED)]) == 0.5
