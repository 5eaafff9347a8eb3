"""Style images for strokes larger than usual: fewer and crisper, in the painting's colours."""

import torch

from stylesplat.stylization.config import USUAL_SCALE
from stylesplat.stylization.style_image import coarsen_style, style_parts

SIDE = 120
NOISE = torch.rand(SIDE, SIDE, 3, generator=torch.Generator().manual_seed(0))
STRIPES = 0.5 + 0.3 * torch.cos(torch.arange(SIDE) * 2 * torch.pi / 12)[:, None, None]
BRISTLES = (STRIPES + 0.2 * (NOISE - 0.5)).clamp(0, 1)


def test_the_usual_strokes_are_the_paintings():
    for scale in (1.0, USUAL_SCALE):
        assert coarsen_style(BRISTLES, scale) is BRISTLES


def test_bristles_become_part_of_crisp_strokes():
    large = coarsen_style(BRISTLES, 4.0)[12:-12, 12:-12]
    assert large.std(dim=1).mean() < 0.5 * BRISTLES.std(dim=1).mean(), "alike along a stroke"
    light = large.mean(dim=(1, 2))
    assert ((light - light.mean()).abs() > 0.6 * light.std()).float().mean() > 0.8, (
        "few are between"
    )
    assert BRISTLES.min() <= large.min() and large.max() <= BRISTLES.max()


def test_flat_areas_stay_flat():
    faint = 0.5 + 0.01 * NOISE
    assert coarsen_style(faint, 4.0).std() < 0.5 * faint.std()


def test_random_parts_stand_for_a_very_large_style_image():
    whole = torch.rand(300, 500, 3)
    assert style_parts(whole, 1000.0, torch.Generator())[0][0] is whole
    parts = style_parts(whole, 4000.0, torch.Generator().manual_seed(0))
    area = sum(part.shape[0] * part.shape[1] for part, _ in parts) * (4000 / 500) ** 2
    assert 0.5e6 < area < 2e6
    assert all(share * 500 == max(part.shape[:2]) for part, share in parts)
