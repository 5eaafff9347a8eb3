"""The picture of a capture: cameras, points, covered sides, from above and from the side."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from still_life.photos import dome_cameras
from stylesplat.figures.capture_picture import (
    BLURRED_RED,
    CAPTURE_PANEL,
    COVERED_GREEN,
    UNCOVERED,
    WEAK,
    capture_picture,
)
from stylesplat.figures.grid import GRID_MARGIN
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.structure_from_motion.diagnostics import CaptureReport
from stylesplat.verbs.sfm import check

DOME = dome_cameras(48, 48, 36)
RED = torch.tensor([230, 20, 20], dtype=torch.uint8)


def photos_of(cameras: Cameras, points: Tensor | None = None) -> Capture:
    colors = None if points is None else RED.expand(len(points), 3)
    photo = torch.randint(256, (36, 48, 3), generator=torch.Generator().manual_seed(0))
    photos = [photo.to(torch.uint8)] * len(cameras)
    return Capture(cameras, photos, points=points, point_colors=colors)


def block(count: int = 3000) -> Tensor:
    """A flat red block around the place that the cameras look at, and strays far away."""
    places = torch.rand(count, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    places[:, 2] = 0.2 * places[:, 2] + 0.38
    places[: count // 100] *= 1000
    return places


def panels(picture: Tensor) -> tuple[Tensor, Tensor]:
    rows = picture[GRID_MARGIN : GRID_MARGIN + CAPTURE_PANEL].float()
    second = 2 * GRID_MARGIN + CAPTURE_PANEL
    return rows[:, GRID_MARGIN : GRID_MARGIN + CAPTURE_PANEL], rows[
        :, second : second + CAPTURE_PANEL
    ]


def like(panel: Tensor, color: tuple[int, ...], slack: int = 50) -> Tensor:
    return (panel - torch.tensor(color)).abs().amax(dim=-1) < slack


def drawn(capture: Capture, report: CaptureReport | None = None) -> tuple[Tensor, Tensor]:
    return panels(capture_picture(capture, report or check(capture)))


def test_points_from_above_and_from_the_side():
    above, side = drawn(photos_of(DOME, block()))
    shown = [like(panel, (232, 60, 60)).nonzero() for panel in (above, side)]
    widths = [
        rows.float().quantile(0.98, dim=0) - rows.float().quantile(0.02, dim=0) for rows in shown
    ]
    high, wide = widths[0].tolist()
    assert high == pytest.approx(wide, rel=0.3), "a square block, perhaps turned"
    high, wide = widths[1].tolist()
    assert high < 0.45 * wide, "flat"
    assert CAPTURE_PANEL / 12 < wide < CAPTURE_PANEL / 2, "strays do not set the scale"
    cameras = like(side, (96, 44, 168)) | like(side, (0, 158, 190))
    above_it = cameras.nonzero()[:, 0] < shown[1][:, 0].float().median()
    assert above_it.float().mean() > 0.95, "up is up, and all look down at it"


@pytest.mark.parametrize(("rows", "gap"), [(range(48), False), (range(8), True)])
def test_sides_that_are_covered(rows: range, gap: bool):
    above, _ = drawn(photos_of(DOME[[*rows]]))
    assert like(above, COVERED_GREEN).sum() > 300
    assert (like(above, UNCOVERED, 30).sum() > 20) == gap


def test_photos_at_fault_stand_out():
    capture = photos_of(DOME)
    fine = check(capture)
    none, _ = drawn(capture, fine)
    assert not like(none, BLURRED_RED, 30).any() and not like(none, WEAK, 30).any()
    some, _ = drawn(capture, replace(fine, blurred=("003.jpg",), weak=("020.jpg", "003.jpg")))
    assert like(some, BLURRED_RED, 30).sum() > 20 and like(some, WEAK, 30).sum() > 20
