from dataclasses import replace

import pytest
import torch

from balls import CAMERAS
from stylesplat.errors import StyleSplatError
from stylesplat.scene.capture import Capture

PHOTO = torch.zeros(36, 48, 3, dtype=torch.uint8)
CAPTURE = Capture(CAMERAS, [PHOTO] * 8)


@pytest.mark.parametrize(
    ("field", "items"),
    [("photos", [PHOTO] * 7), ("label maps", [None] * 7), ("alphas", [None] * 7)],
)
def test_one_of_each_per_camera(field: str, items: list):
    with pytest.raises(StyleSplatError, match=f"Expected 8 {field}, one per camera, got 7"):
        replace(CAPTURE, **{field.replace(" ", "_"): items})


def test_photos_need_neither_label_maps_nor_alphas():
    assert CAPTURE.labels(3) is None and CAPTURE.alpha(3) is None


def test_label_maps_and_alphas_of_single_photos():
    maps = [torch.full((36, 48), row) if row else None for row in range(8)]
    alphas = [torch.full((36, 48), row, dtype=torch.uint8) if row else None for row in range(8)]
    both = replace(CAPTURE, label_maps=maps, alphas=alphas)
    assert both.labels(0) is None and both.alpha(0) is None
    assert both.labels(3) is maps[3] and both.alpha(3) is alphas[3]
