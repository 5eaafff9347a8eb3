"""Boxes around the balls in photos of theirs, and how well masks fit them."""

from dataclasses import replace
from typing import Any

import pytest

from balls import CAMERAS, SPLATS, enlarged
from stylesplat.masks import from_boxes as mask_boxes
from stylesplat.masks import quick_splat as working
from stylesplat.masks.grabcut import Box
from stylesplat.scene.capture import Capture
from stylesplat.scene.labels import resize_labels
from stylesplat.scene.scene import Scene
from stylesplat.selection.identities import render_labels

HALF = enlarged(CAMERAS, 2)  # that `mask` works at
LARGE = enlarged(CAMERAS, 4)  # the photos; worked on at half of that
PLAIN = replace(SPLATS, identities=None, classifier=None)


def box(id: int, row: int) -> Box:
    """Around a ball in the pixels of a photo, some pixels apart."""
    y, x = ((render_labels(SPLATS, LARGE[row]) == id).nonzero().T).float()
    (width, height), margin = LARGE.size, 4.0
    left, top = max(0.0, float(x.min()) - margin), max(0.0, float(y.min()) - margin)
    right, bottom = float(x.max()) + 1 + margin, float(y.max()) + 1 + margin
    return left, top, min(float(width), right), min(float(height), bottom)


VASE = ("0001.jpg", box(3, 1))
CUP = ("0005.jpg", box(7, 5))
BALLS = Scene(PLAIN, CAMERAS)  # at a size of its own, as `import` and `train --downscale` make them


def agreement(masked: Capture, id: int, ball: int) -> list[float]:
    """IoU per photo of what is masked as an id with a ball, at the size that it was made at."""
    assert masked.label_maps is not None
    ious = []
    for row in range(len(masked)):
        labels, truth = masked.label_maps[row], render_labels(SPLATS, HALF[row]) == ball
        assert labels is not None
        assert labels.shape == masked.cameras[row].size[::-1]
        mask = resize_labels(labels, truth.shape) == id
        ious.append(float((mask & truth).sum() / (mask | truth).sum()))
    return ious


def work_at_half_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut objects out of photos of half the size."""
    monkeypatch.setattr(mask_boxes, "SIZE", HALF.size[0])


def fail_at_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Training and rendering fail."""

    def fail(*args: Any, **kwargs: Any) -> None:
        raise AssertionError("work has begun")

    monkeypatch.setattr(working, "fit", fail)
    monkeypatch.setattr(mask_boxes, "propagate_boxes", fail)
