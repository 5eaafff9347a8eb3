"""Blur, exposure and white balance of photos, told apart from what they show."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from stylesplat.demo.demo_run import copy_capture
from stylesplat.scene.capture import Capture
from stylesplat.structure_from_motion.findings import on_looks
from stylesplat.structure_from_motion.photo_looks import photo_looks
from stylesplat.verbs.load import load


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
    found = on_looks(photo_looks(capture), capture.cameras.names)
    return {each.what: each.verdict for each in found}


def test_nothing_amiss(capture: Capture):
    assert set(verdicts(capture).values()) == {"good"}


@pytest.mark.parametrize("gain", [0.5, 0.75])
def test_exposure_is_told_in_steps(capture: Capture, gain: float):
    before = photo_looks(capture)
    photo = capture.photos[4].numpy() * gain
    after = photo_looks(changed(capture, 4, photo))
    steps = float(after.stops[4] - before.stops[4])
    # The tracer's sRGB is a power of 2.2 but for its darkest part
    assert steps == pytest.approx(2.2 * np.log2(gain), abs=0.15)
    others = torch.arange(len(capture)) != 4
    assert (after.stops - before.stops)[others].abs().max() < 0.1


def test_white_balance_is_no_exposure(capture: Capture):
    before = photo_looks(capture)
    after = photo_looks(changed(capture, 4, capture.photos[4].numpy() * [1.12, 1.0, 0.88]))
    assert after.warmth[4] - before.warmth[4] > 0.5
    assert abs(after.stops[4] - before.stops[4]) < 0.15


def test_exposure_that_wanders_is_said(capture: Capture):
    for row in range(len(capture)):
        photo = capture.photos[row].numpy() * np.linspace(0.6, 1, len(capture))[row]
        capture = changed(capture, row, photo)
    assert verdicts(capture)["exposure"] == "fair"
    finding = on_looks(photo_looks(capture), capture.cameras.names)[1]
    assert "steps of exposure" in finding.says and "Colour correction" in finding.advice


def test_a_blurred_photo_is_named(capture: Capture):
    blurred = cv2.GaussianBlur(capture.photos[4].numpy(), (0, 0), 4)
    finding = on_looks(photo_looks(changed(capture, 4, blurred)), capture.cameras.names)[0]
    assert finding.verdict == "fair" and finding.says == "blurred: 016.jpg"


def test_without_points_whole_photos_are_compared(capture: Capture):
    bare = replace(capture, points=None, point_colors=None)
    assert capture.points is not None and capture.point_colors is not None
    few = replace(capture, points=capture.points[:9], point_colors=capture.point_colors[:9])
    assert not photo_looks(few).by_points
    dark = changed(bare, 4, bare.photos[4].numpy() * 0.5)
    looks = photo_looks(dark)
    assert not looks.by_points and looks.stops[4] < -1.5
    assert "going by whole photos" in on_looks(looks, capture.cameras.names)[1].says


def test_a_black_photo_tells_nothing_and_breaks_nothing(capture: Capture):
    looks = photo_looks(changed(capture, 4, np.zeros((120, 160, 3))))
    assert looks.stops[4].isnan() and looks.stops.isfinite().sum() == 11
    assert looks.sharpness[4] == 0
