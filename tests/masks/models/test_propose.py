"""The filters of proposed masks, with a model that answers from a script."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from stylesplat.masks.models import propose
from stylesplat.masks.models.propose import GridProposer

SIDE, SMALL = 64, 16  # pixels of the scripted model's input and of its masks
Answer = tuple[slice, slice, float, float]  # rows and columns of a mask, its logit, its quality


@dataclass
class Script:
    """Answers three masks for every point: the last that lies there, and two bad ones."""

    answers: list[Answer]
    asked: list[Tensor] = field(default_factory=list)
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    dtype: torch.dtype = torch.float32

    def get_image_embeddings(self, pixels: Tensor) -> Tensor:
        return pixels

    def __call__(self, image_embeddings: Tensor, input_points: Tensor, input_labels: Tensor) -> Any:
        points = input_points[0, :, 0]
        assert input_labels.shape == (1, len(points), 1) and (input_labels == 1).all()
        self.asked.append(points)
        masks = torch.full((1, len(points), 3, SMALL, SMALL), -9.0)
        qualities = torch.zeros(1, len(points), 3)
        for number, (x, y) in enumerate((points * SMALL / SIDE).tolist()):
            for rows, columns, logit, quality in self.answers:
                if rows.start <= y < rows.stop and columns.start <= x < columns.stop:
                    masks[0, number, 1] = -9.0
                    masks[0, number, 1, rows, columns] = logit
                    qualities[0, number, 1] = quality
        return SimpleNamespace(pred_masks=masks, iou_scores=qualities)


LEFT = (slice(2, 14), slice(1, 7), 9.0, 0.90)
RIGHT = (slice(4, 12), slice(9, 15), 9.0, 0.95)


def proposer(script: Script, **settings: Any) -> GridProposer:
    from transformers import Sam2ImageProcessor

    processor = Sam2ImageProcessor(size={"height": SIDE, "width": SIDE})
    return GridProposer(script, processor, **{"points_per_side": 8, **settings})


def photo(height: int = 32, width: int = 64) -> Tensor:
    return torch.zeros(height, width, 3, dtype=torch.uint8)


def test_each_object_once_the_best_first():
    masks = proposer(Script([LEFT, RIGHT])).propose(photo())
    assert len(masks) == 2
    # 32 x 64 pixels: a small mask's pixel is 2 high and 4 wide
    right, left = masks
    for mask, (rows, columns) in (
        (right, (slice(8, 24), slice(36, 60))),
        (left, (slice(4, 28),) * 2),
    ):
        expected = torch.zeros_like(mask)
        expected[rows, columns] = True
        assert (mask != expected).sum() == 4, "all but the corners, which smooth enlarging cuts"


@pytest.mark.parametrize("pixels", [1, 5000, 2**24])
@pytest.mark.parametrize("points", [1, 7, 64])
def test_how_many_at_once_changes_nothing(points: int, pixels: int, monkeypatch):
    monkeypatch.setattr(propose, "PIXELS_AT_ONCE", pixels)
    script = Script([LEFT, RIGHT])
    masks = proposer(script, points_at_once=points).propose(photo())
    assert [int(mask.sum()) for mask in masks] == [384 - 4, 576 - 4]
    assert max(len(some) for some in script.asked) == points
    assert sum(len(some) for some in script.asked) == 64


def test_masks_of_low_quality_are_dropped():
    script = Script([LEFT, RIGHT])
    assert len(proposer(script, min_iou=0.92).propose(photo())) == 1
    assert proposer(script, min_iou=0.99).propose(photo()) == []


def test_masks_with_an_uncertain_border_are_dropped():
    faint = (*LEFT[:2], 0.5, 0.99)  # no pixel is above 1
    script = Script([faint, RIGHT])
    assert len(proposer(script).propose(photo())) == 1
    assert len(proposer(script, min_stability=0.0).propose(photo())) == 2


def test_masks_without_a_pixel_are_dropped():
    nothing = (*LEFT[:2], -0.5, 0.99)
    assert proposer(Script([nothing]), min_stability=0.0).propose(photo()) == []


def test_copies_are_told_by_their_boxes():
    larger = (slice(2, 14), slice(1, 8), 9.0, 0.85)  # box of LEFT and a column: IoU 6 / 7
    script = Script([larger, LEFT])  # only the column's points answer with the first
    assert len(proposer(script, min_iou=0.5, points_per_side=16).propose(photo())) == 1
    kept = proposer(script, min_iou=0.5, points_per_side=16, max_overlap=0.9).propose(photo())
    assert len(kept) == 2


def test_the_grid_covers_the_models_input():
    script = Script([LEFT])
    proposer(script, points_per_side=4).propose(photo())
    points = torch.cat(script.asked)
    assert sorted(set(points[:, 0].tolist())) == [8, 24, 40, 56]
    assert sorted(set(points[:, 1].tolist())) == [8, 24, 40, 56]
    assert points[1].tolist() == [24, 8], "x first"


def test_the_grid_leaves_out_padding():
    """The first SAM keeps the photo's proportions and pads below or to the right."""
    from transformers import SamImageProcessor

    size = {"height": SIDE, "width": SIDE}
    processor = SamImageProcessor(size={"longest_edge": SIDE}, pad_size=size)
    script = Script([(slice(0, 8), slice(0, 8), 9.0, 0.9)])
    (mask,) = GridProposer(script, processor, points_per_side=4).propose(photo())
    points = torch.cat(script.asked)
    assert sorted(set(points[:, 0].tolist())) == [8, 24, 40, 56]
    assert sorted(set(points[:, 1].tolist())) == [4, 12, 20, 28]
    # The top left quarter of the padded square is the left half of the photo
    assert mask[:, :30].all() and not mask[:, 34:].any()


def test_masks_are_on_the_photos_device_and_carry_no_gradients():
    (mask,) = proposer(Script([LEFT])).propose(photo())
    assert mask.device == photo().device and not mask.requires_grad and mask.dtype == torch.bool
