"""The script that made the demo's capture: exact photos, and label maps with mistakes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

import stylesplat as ss
from still_life.label_faults import FaultConfig, corrupt_label_maps
from still_life.make import write_capture
from still_life.photos import dome_cameras, photograph
from still_life.turntable import turned_layouts, turntable
from stylesplat.scene.projection import project

NO_FAULTS = {"border": 0.0, "missing": 0.0, "merged": 0.0, "fragments": 0.0}


def test_a_tiny_capture(tmp_path: Path):
    """Objects are seen, and points lie on what views see, whichever view they come from."""
    write_capture(tmp_path / "made", views=6, width=48, height=36)
    capture = ss.load(tmp_path / "made", masks=tmp_path / "made/object_mask_exact")
    assert capture.label_maps is not None and capture.points is not None
    labels = torch.stack([m for m in capture.label_maps if m is not None])
    assert labels.unique().tolist() == [0, 1, 2, 3, 4, 5]
    colors = torch.stack([*capture.photos]).float()
    assert colors.std() > 30 and (colors == 255).float().mean() < 0.02
    for row in (0, 3):
        assert 0.15 < point_agreement(capture, row), "points of all views, a part of which it sees"
    assert len([*(tmp_path / "made/styles").iterdir()]) == 3


def point_agreement(capture: ss.Capture, row: int) -> float:
    """How many points have about the colour of the pixel at which a view may see them."""
    assert capture.points is not None and capture.point_colors is not None
    pixels, depths = project(capture.points, capture.cameras[row])
    columns, rows = pixels.floor().long().unbind(1)
    inside = (depths > 0) & (rows >= 0) & (rows < 36) & (columns >= 0) & (columns < 48)
    photo = capture.photos[row].float()[rows[inside], columns[inside]]
    off = (photo - capture.point_colors[inside].float()).abs().amax(dim=1)
    return float((off < 25).float().mean())


def discs() -> torch.Tensor:
    """Two touching discs and one apart, with ids 1, 7 and 300."""
    y, x = np.indices((90, 120))
    labels = np.zeros((90, 120), np.int64)
    for id, cx, cy in ((1, 30, 30), (7, 66, 30), (300, 85, 70)):
        labels[np.hypot(x - cx, y - cy) < 18] = id
    return torch.from_numpy(labels)


def corrupted(**faults: float) -> torch.Tensor:
    return corrupt_label_maps([discs()], config=FaultConfig(**(NO_FAULTS | faults)))[0]


def test_faults_are_those_that_the_settings_ask_for():
    exact = discs()
    assert torch.equal(corrupted(), exact)
    frayed = corrupted(border=16.0)  # 4 pixels at this width
    assert 0.01 < (frayed != exact).float().mean() < 0.10
    assert frayed[30, 30] == 1 and frayed[70, 85] == 300
    assert corrupted(missing=1.0).unique().tolist() == [0]
    assert corrupted(merged=1.0).unique().tolist() in ([0, 1, 300], [0, 7, 300])
    patched = corrupted(fragments=1.0)
    changed = patched != exact
    assert changed.any() and (exact[changed] > 0).all() and (patched[changed] > 0).all()


def test_turning_the_objects_is_walking_around_them():
    pictures, viewmats = turntable(5, 32, 24)
    turned = [view.labels > 0 for view in pictures]
    walked = dome_cameras(5, 32, 24)
    walked = replace(walked, viewmats=viewmats.float())
    views = photograph(walked, turned_layouts(5)[0])
    for one, other in zip(turned, (view.labels > 0 for view in views), strict=True):
        assert one.any() and (one == other).float().mean() > 0.99
    assert not torch.equal(turned[0], turned[2])
