"""What is said of a stylisation is true."""

from typing import Any

import pytest

from stylesplat.evaluation.summary import (
    SUMMARY_WHOLE,
    describe_changes,
    photo_lines,
    style_lines,
)

QUIET = {"changed_outside": 0, "outside_max_difference": 0.0, "stain_pixels": 0}
STAIN = {"stain_pixels": 1200, "stain_view": "a.jpg"}


def vase(after: float, share: float | None = None, own: float = 0.1, **more: float) -> dict:
    numbers = {"nnfm_after": after, "nnfm_of_style": own, "share_of_way": share, **more}
    return QUIET | {name: {"vase": each} for name, each in numbers.items() if each is not None}


WAY = "71 % of the way to the painting"
STRAY = "12 % of it in colours that the painting does not have"


@pytest.mark.parametrize(
    ("metrics", "expected"),
    [
        (vase(0.12, 0.714), WAY),
        (vase(0.08, 1.0), SUMMARY_WHOLE),
        (vase(0.1001, 0.999), "99 % of the way to the painting"),
        (vase(0.05), SUMMARY_WHOLE),
        (vase(0.2), "painted"),
        (vase(0.12, 0.714, off_palette=0.123), f"{WAY}, {STRAY}"),
        (vase(0.12, 0.714, off_palette=0.05), WAY),
        (vase(0.12, 0.714, bare=0.004), WAY),
        (vase(0.12, 0.714, bare=0.031), f"{WAY}, 3 % of it without paint"),
    ],
)
def test_one_object_in_one_line(metrics: dict[str, Any], expected: str):
    assert style_lines(metrics, ["vase"]) == [f"vase: {expected}, nothing else changed."]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (STAIN, "a stain of 1,200 pixels beside the object in view a.jpg"),
        ({"outside_max_difference": 3 / 255}, "pixels beside by 3 of 255 levels at most"),
        ({"changed_outside": 1200}, "1,200 Gaussians outside changed as well"),
    ],
)
def test_what_changed_around_is_said(change: dict[str, Any], expected: str):
    assert expected in describe_changes(QUIET | change)
    unknown = {name: value for name, value in QUIET.items() if name != "stain_pixels"}
    assert describe_changes(unknown) == "no other Gaussian changed"


def test_photos_and_label_maps():
    assert photo_lines({}) == []
    numbers = {"psnr": 30.554, "ssim": 0.9, "miou": 0.956, "boundary_miou": 0.8}
    photos, objects = photo_lines(numbers)
    assert "30.55 dB" in photos and "0.96" in objects and "0.80" in objects
