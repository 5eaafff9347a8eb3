"""The figures of `looks.py`, `strokes.py` and `stroke_length.py` where they are known."""

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
import torch
from judge import (
    Sight,
    features_kept,
    nnfm_of_views,
    outline_errors,
    painting_features,
)
from paintings import line_print
from stroke_length import detail_length
from strokes import apparent_size
from target_2d import target_2d

from balls import CAMERAS
from scenes import rand
from stylesplat.io.style_pictures import resize
from stylesplat.stylization.features import FeatureNetwork, load_weights

SIZE = 96
SHARE = torch.zeros(SIZE, SIZE)
SHARE[8:-8, 8:-8] = 1
BEFORE = rand(SIZE, SIZE, 3)
SIGHT = Sight(CAMERAS[0], (slice(0, SIZE), slice(0, SIZE)), BEFORE, SHARE, 80)
YS, XS = torch.meshgrid(torch.arange(160), torch.arange(160), indexing="ij")
PALETTE = torch.tensor([[0.9, 0.8, 0.1], [0.1, 0.1, 0.6], [0.8, 0.2, 0.1]])
STRIPES = PALETTE[(XS + 2 * YS) // 9 % 3]  # of the size at which it is compared: 2 x 80


@pytest.fixture(scope="module")
def compact() -> FeatureNetwork:
    return load_weights("compact", depth=3)


def kept(image: torch.Tensor) -> tuple[float, float]:
    return features_kept([SIGHT], [image])


def test_features_are_kept_in_other_colours_and_lost_in_other_shapes():
    grey = 0.2 + 0.5 * BEFORE.mean(dim=-1, keepdim=True).expand(-1, -1, 3)
    assert kept(BEFORE) == pytest.approx((1, 1), abs=0.01)
    assert kept(0.1 + 0.3 * BEFORE) == pytest.approx((1, 1), abs=0.02)
    assert min(kept(grey)) > 0.7  # luminance weighs green more
    assert max(map(abs, kept(BEFORE.flip(0)))) < 0.2
    assert kept(torch.full_like(BEFORE, 0.5)) == pytest.approx((0, 0), abs=0.01)


def test_what_has_most_contrast_does_not_speak_for_all_places():
    before = 0.5 + 0.05 * (BEFORE - 0.5)
    before[:, 48:] += (XS[:SIZE, 48:SIZE, None] // 6 % 2) * 0.4
    after = before.clone()
    after[:, :46] = before[:, :46].flip(0)
    sight = replace(SIGHT, before=before)
    whole, local = features_kept([sight], [after])
    assert whole > 0.95
    assert local < whole - 0.02


def test_paint_beside_an_outline_is_spill_and_bare_places_are_missed():
    inside = SHARE > 0
    after = torch.where(inside[..., None], 1 - BEFORE, BEFORE)
    assert outline_errors(BEFORE, after, inside, 2.0) == (0, pytest.approx(0, abs=0.01), 0)
    after[:, :4] = 1 - BEFORE[:, :4]  # 4 to 8 pixels beside
    after[20:40, 20:40] = BEFORE[20:40, 20:40]
    spill, missed, stain = outline_errors(BEFORE, after, inside, 2.0)
    assert spill == pytest.approx(4 * SIZE / 80**2, rel=0.1)
    assert missed == pytest.approx(400 / 76**2, rel=0.1)
    assert stain == pytest.approx(4 * SIZE, rel=0.1)


def test_a_cut_out_of_the_painting_is_near_to_it(compact: FeatureNetwork):
    cut = STRIPES[:SIZE, :SIZE]
    for size in (1.0, 0.5):
        (own,) = nnfm_of_views([SIGHT], [cut], STRIPES, compact, size)
        (noise,) = nnfm_of_views([SIGHT], [BEFORE], STRIPES, compact, size)
        assert own < 0.3 * noise


def test_free_pixels_come_closer_and_leave_the_rest(compact: FeatureNetwork):
    targets = [(1.0, painting_features([SIGHT], STRIPES, compact, 1.0))]
    found = target_2d(SIGHT, STRIPES.reshape(-1, 3), targets, compact, 30)
    assert torch.equal(found[SHARE == 0], BEFORE[SHARE == 0])
    before, after = (
        nnfm_of_views([SIGHT], [image], STRIPES, compact, 1.0)[0] for image in (BEFORE, found)
    )
    assert after < 0.8 * before
    assert found[SHARE > 0].mean(dim=0) == pytest.approx(STRIPES.mean(dim=(0, 1)), abs=0.1)


def test_strokes_seem_as_large_as_the_picture_that_they_are_cut_from():
    network, picture = load_weights("compact", depth=3), torch.from_numpy(line_print()) / 255
    mask = torch.ones(120, 120, dtype=torch.bool)
    for size in (1, 4):
        image = resize(picture, size * 150.0)[-120:, -120:]
        assert apparent_size(network, [(image, mask)], picture, 150.0)[0] == size


def blobs(size: float) -> torch.Tensor:
    """Grey noise blurred to a size in pixels."""
    noise = np.random.default_rng(0).standard_normal((SIZE, SIZE)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), size)
    grey = torch.from_numpy(0.5 + 0.15 * smooth / smooth.std())
    return grey[..., None].expand(SIZE, SIZE, 3)


def test_the_length_of_strokes_doubles_when_they_do_and_is_that_of_nothing_else():
    before = 0.4 + 0.2 * BEFORE
    lengths = [detail_length(before, blobs(size), SHARE > 0, 80) for size in (1, 2, 4)]
    ratios = [b / a for a, b in pairwise(lengths)]
    assert ratios == pytest.approx([2, 2], rel=0.25)  # as far as its file says it holds
    recoloured = before.flip(-1) * 0.5 + 0.3 + 0.3 * (blobs(4) - 0.5)
    assert detail_length(before, recoloured, SHARE > 0, 80) > 4, "of the strokes, not the pattern"
