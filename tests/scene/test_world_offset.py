"""Worlds whose coordinates are too large for float32: when they get an offset, and which."""

import math

import pytest
import torch

from scenes import randn
from stylesplat.scene.world_offset import ORIGIN, choose_offset, from_world, to_world

UTM, ECEF = (448262.25, 5411932.68, 35.5), (4e6, -3e6, 5e6)


def around(place: tuple[float, float, float], extent: float = 3.0) -> torch.Tensor:
    return extent * randn(400, 3).double() + torch.tensor(place, dtype=torch.float64)


@pytest.mark.parametrize("place", [UTM, ECEF, (12_000.0, 0.0, -7_000.0)])
def test_it_is_whole_and_in_the_middle(place: tuple[float, float, float]):
    offset = choose_offset(around(place))
    assert all(value == round(value) for value in offset)
    assert offset == pytest.approx(place, abs=1)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (20.0, -4.0, 100.0), (0.0, 600.0, 0.0)])
def test_ordinary_places_get_none(place: tuple[float, float, float]):
    assert choose_offset(around(place)) == ORIGIN
    assert choose_offset(around(place).float()) == ORIGIN


def test_strays_count_for_nothing():
    positions = around(UTM)
    positions[::20] = torch.tensor([0.0, 1e8, math.nan], dtype=torch.float64)
    positions[1::20] = torch.tensor([1e6, -1e12, math.inf], dtype=torch.float64)
    assert choose_offset(positions) == pytest.approx(UTM, abs=1)
    ordinary = around((1.0, 2.0, 3.0))
    ordinary[::20] = 1e7
    assert choose_offset(ordinary) == ORIGIN


def test_single_places_and_none():
    """One standpoint, or one Gaussian, has no extent."""
    assert choose_offset(torch.tensor([[3.0, 2.0, -20.0]])) == ORIGIN
    assert choose_offset(torch.tensor([UTM], dtype=torch.float64)) == (448262.0, 5411933.0, 36.0)
    assert choose_offset(torch.zeros(0, 3)) == choose_offset(torch.full((3, 3), math.nan)) == ORIGIN


def test_there_and_back():
    points = randn(5, 3)
    assert torch.equal(from_world(to_world(points, ECEF), ECEF).float(), points)
