"""Sides and heights that photos cover, blur and exposure, and the diagnostics that follow."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from still_life.photos import dome_cameras
from stylesplat.demo.demo_run import copy_capture
from stylesplat.io.captures.capture_folder import load
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.structure_from_motion.diagnostics import (
    diagnose_distances,
    diagnose_heights,
    diagnose_photos,
    diagnose_sides,
)
from stylesplat.structure_from_motion.world_frame import (
    Coverage,
    find_centre,
    measure_coverage,
    measure_photos,
    working_frame,
)

DOME = dome_cameras(48, 480, 360)


def covered(cameras: Cameras, points: Tensor | None = None) -> Coverage:
    frame = working_frame(cameras, torch.zeros(0, 3) if points is None else points)
    outward = find_centre(cameras, points).outward
    return measure_coverage(cameras, frame, outward=outward)


def test_two_whole_rings():
    coverage = covered(DOME)
    assert coverage.arc == 360 and coverage.largest_gap == pytest.approx(7.5, abs=0.1)
    assert coverage.heights == 2 and not coverage.outward
    assert 14 < coverage.lowest < 20 < 45 < coverage.highest < 51
    assert coverage.near == pytest.approx(1, abs=1e-3) == pytest.approx(coverage.far, abs=2e-3)
    assert coverage.elevations.endswith(" degrees above the middle")
    deep = replace(coverage, lowest=-30.2, highest=38.0)
    assert deep.elevations == "30 degrees below to 38 above the middle"
    findings = (
        diagnose_sides(coverage, 48),
        diagnose_heights(coverage),
        diagnose_distances(coverage),
    )
    assert all(each.verdict == "good" and not each.advice for each in findings)


@pytest.mark.parametrize(
    ("photos", "verdict"), [(1, "poor"), (6, "poor"), (12, "fair"), (18, "fair")]
)
def test_a_part_of_a_ring(photos: int, verdict: str):
    coverage = covered(DOME[:photos])  # 15 degrees from each to the next
    assert coverage.arc == pytest.approx(15 * (photos - 1), abs=3)
    assert coverage.largest_gap == pytest.approx(360 - coverage.arc, abs=0.1)
    assert coverage.heights == 1 and diagnose_heights(coverage).verdict == "fair"
    assert diagnose_sides(coverage, photos).verdict == verdict
    assert diagnose_sides(coverage, 40).verdict == ("poor" if photos == 1 else "fair")


def test_turning_on_the_spot():
    turns = torch.linspace(0, 2 * math.pi, 13)[:-1]
    viewmats = torch.eye(4).repeat(12, 1, 1)
    viewmats[:, 0, 0] = viewmats[:, 2, 2] = turns.cos()
    viewmats[:, 0, 2], viewmats[:, 2, 0] = -turns.sin(), turns.sin()
    noise = torch.randn(500, 3, generator=torch.Generator().manual_seed(0))
    points = 5 * torch.nn.functional.normalize(noise, dim=1)
    coverage = covered(replace(DOME[:12], viewmats=viewmats), points)
    assert coverage.outward and coverage.arc == 360
    assert diagnose_sides(coverage, 12).verdict == "good"
    finding = diagnose_distances(coverage)
    assert finding.what == "movement" and finding.verdict == "poor"


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """Twelve photos of 160x120, of both rings around the demo's still life."""
    whole = load(copy_capture(tmp_path_factory.mktemp("demo") / "still_life"), downscale=3.0)
    rows = range(0, 48, 4)
    photos = [whole.photos[row] for row in rows]
    points, colors = whole.points, whole.point_colors
    return Capture(whole.cameras[rows], photos, points=points, point_colors=colors)


def changed(capture: Capture, row: int, photo: np.ndarray) -> Capture:
    photos = list(capture.photos)
    photos[row] = torch.from_numpy(np.clip(photo, 0, 255).round().astype(np.uint8))
    return replace(capture, photos=photos)


def verdicts(capture: Capture) -> dict[str, str]:
    found = diagnose_photos(measure_photos(capture), capture.cameras.names)
    return {each.what: each.verdict for each in found}


def test_exposure_and_white_balance_are_measured_in_stops(capture: Capture):
    before, photo = measure_photos(capture), capture.photos[4].numpy()
    after = measure_photos(changed(capture, 4, photo * 0.5))
    # The tracer's sRGB is a power of 2.2 but for its darkest part
    assert after.stops[4] - before.stops[4] == pytest.approx(-2.2, abs=0.3)
    others = torch.arange(len(capture)) != 4
    assert (after.stops - before.stops)[others].abs().max() < 0.1
    warmer = measure_photos(changed(capture, 4, photo * [1.12, 1.0, 0.88]))
    assert warmer.warmth[4] - before.warmth[4] > 0.5
    assert abs(warmer.stops[4] - before.stops[4]) < 0.15
    black = measure_photos(changed(capture, 4, 0 * photo))
    assert black.stops[4].isnan() and black.stops[others].isfinite().all()


def test_verdicts_on_photos(capture: Capture):
    assert set(verdicts(capture).values()) == {"good"}
    blurred = changed(capture, 4, cv2.GaussianBlur(capture.photos[4].numpy(), (0, 0), 4))
    assert verdicts(blurred)["sharpness"] == "fair"
    assert "016.jpg" in diagnose_photos(measure_photos(blurred), capture.cameras.names)[0].says
    for row in range(len(capture)):
        photo = capture.photos[row].numpy() * np.linspace(0.6, 1, len(capture))[row]
        capture = changed(capture, row, photo)
    assert verdicts(capture)["exposure"] == "fair"


def test_without_points_whole_photos_are_compared(capture: Capture):
    assert capture.points is not None and capture.point_colors is not None
    few = replace(capture, points=capture.points[:9], point_colors=capture.point_colors[:9])
    assert not measure_photos(few).by_points
    bare = replace(capture, points=None, point_colors=None)
    dark = measure_photos(changed(bare, 4, bare.photos[4].numpy() * 0.5))
    assert not dark.by_points and dark.stops[4] < -1.5


def test_pixels_that_are_masked_out_do_not_count(capture: Capture):
    height, width = capture.photos[0].shape[:2]
    valid = torch.arange(width).expand(height, width) < 0.6 * width
    masked = replace(capture, valid_masks=[valid] * len(capture))
    noise = np.random.default_rng(0).integers(0, 256, (height, width, 3))
    other = np.where(valid[..., None].numpy(), capture.photos[4].numpy(), noise)
    for start in (masked, replace(masked, points=None, point_colors=None)):
        before, after = measure_photos(start), measure_photos(changed(start, 4, other))
        for name in ("sharpness", "stops", "warmth"):
            assert torch.equal(getattr(before, name), getattr(after, name))
