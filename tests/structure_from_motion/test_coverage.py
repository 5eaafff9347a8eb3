"""Sides and heights that photos cover, and what is said of them."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from still_life.photos import dome_cameras
from stylesplat.scene.cameras import Cameras
from stylesplat.structure_from_motion.centre import find_centre
from stylesplat.structure_from_motion.coverage import Coverage, measure_coverage
from stylesplat.structure_from_motion.findings import on_distances, on_heights, on_sides
from stylesplat.structure_from_motion.frame import working_frame

DOME = dome_cameras(48, 480, 360)


def covered(cameras: Cameras, points: Tensor | None = None) -> Coverage:
    places = torch.zeros(0, 3) if points is None else points
    frame = working_frame(cameras, places)
    outward = find_centre(cameras, points).outward
    return measure_coverage(cameras, points, frame, outward=outward)


def wall() -> Tensor:
    """Behind what the dome's first cameras look at: they stand at positive x."""
    places = torch.rand(2000, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    places[:, 0] = -0.1
    return places


def test_two_whole_rings():
    coverage = covered(DOME)
    assert coverage.arc == 360 and coverage.largest_gap == pytest.approx(7.5, abs=0.1)
    assert coverage.heights == 2 and not coverage.outward and not coverage.facing
    assert 14 < coverage.lowest < 20 < 45 < coverage.highest < 51
    assert coverage.near == pytest.approx(1, abs=1e-3) == pytest.approx(coverage.far, abs=2e-3)
    for finding in (on_sides(coverage, 48), on_heights(coverage), on_distances(coverage)):
        assert finding.verdict == "good" and not finding.advice


@pytest.mark.parametrize("photos", [6, 12, 18])
def test_a_part_of_a_ring(photos: int):
    coverage = covered(DOME[:photos])  # 15 degrees from each to the next
    assert coverage.arc == pytest.approx(15 * (photos - 1), abs=3)
    assert coverage.largest_gap == pytest.approx(360 - coverage.arc, abs=0.1)
    assert coverage.heights == 1
    assert on_heights(coverage).verdict == "fair"
    finding = on_sides(coverage, photos)
    assert (finding.verdict == "poor") == (photos == 6)
    if photos == 6:
        assert finding.line.startswith("6 photos from one side only, 7")
        assert finding.line.endswith("Walk around the object.")


def test_two_parts_on_opposite_sides_leave_two_gaps():
    coverage = covered(DOME[[*range(6), *range(12, 18)]])
    assert coverage.arc == pytest.approx(150, abs=5)
    assert coverage.largest_gap == pytest.approx(105, abs=5)


def test_photos_of_a_wall_are_no_fault():
    front = DOME[[*range(22, 24), *range(3), *range(46, 48), *range(24, 27)]]
    free, before = covered(front), covered(front, wall())
    assert not free.facing and before.facing
    assert on_sides(free, 10).verdict == "poor"
    finding = on_sides(before, 10)
    assert finding.verdict == "good" and "views from behind will be empty" in finding.says


def test_from_one_side_many_photos_are_fair():
    finding = on_sides(covered(DOME[:6]), 40)
    assert finding.verdict == "fair" and "from one side, 7" in finding.says


def test_turning_on_the_spot():
    turns = torch.linspace(0, 2 * math.pi, 13)[:-1].tolist()
    viewmats = torch.eye(4).repeat(12, 1, 1)
    for row, turn in enumerate(turns):
        viewmats[row, 0, 0] = viewmats[row, 2, 2] = math.cos(turn)
        viewmats[row, 0, 2], viewmats[row, 2, 0] = -math.sin(turn), math.sin(turn)
    cameras = replace(DOME[:12], viewmats=viewmats)
    points = 5 * torch.nn.functional.normalize(
        torch.randn(500, 3, generator=torch.Generator().manual_seed(0)), dim=1
    )
    coverage = covered(cameras, points)
    assert coverage.outward and coverage.arc == 360
    finding = on_distances(coverage)
    assert finding.what == "movement" and finding.verdict == "poor"
    assert "walk, instead of turning on the spot" in finding.advice


def test_one_camera():
    coverage = covered(DOME[:1])
    assert (coverage.arc, coverage.largest_gap, coverage.heights) == (0, 360, 1)
    assert on_sides(coverage, 1).verdict == "poor"


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (-30.2, 38.0, "30 degrees below to 38 above the middle"),
        (12.0, 50.0, "12 to 50 degrees above the middle"),
        (-40.0, -10.0, "10 to 40 degrees below the middle"),
    ],
)
def test_elevations_in_words(low: float, high: float, words: str):
    assert replace(covered(DOME[:2]), lowest=low, highest=high).elevations == words
