"""The length of strokes doubles when they do, and is that of nothing else."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
import torch
from strokes import detail_length

SIZE = 128
MASK = torch.zeros(SIZE, SIZE, dtype=torch.bool)
MASK[8:-8, 8:-8] = True
BEFORE = torch.rand(SIZE, SIZE, 3, generator=torch.Generator().manual_seed(3)) * 0.2 + 0.4


def blobs(size: float, seed: int = 0) -> torch.Tensor:
    """Grey noise blurred to a size in pixels."""
    noise = np.random.default_rng(seed).standard_normal((SIZE, SIZE)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), size)
    grey = torch.from_numpy(0.5 + 0.15 * smooth / smooth.std())
    return grey[..., None].expand(SIZE, SIZE, 3)


def test_twice_the_strokes_are_twice_as_long():
    lengths = [detail_length(BEFORE, blobs(size), MASK, 112) for size in (1, 2, 4)]
    ratios = [b / a for a, b in pairwise(lengths)]
    assert ratios == pytest.approx([2, 2], rel=0.25)  # as far as its file says it holds


def test_the_same_pattern_in_other_colours_adds_nothing_of_its_length():
    recoloured = BEFORE.flip(-1) * 0.5 + 0.3 + 0.3 * (blobs(4) - 0.5)
    assert detail_length(BEFORE, recoloured, MASK, 112) > 4, "of the strokes, not of the pattern"
