"""The still life with Gaussians in one ball that are much larger than strokes."""

from dataclasses import replace

import torch

from balls import SPLATS
from stylesplat.scene.splats import Splats

TABLE, BALL = 200, 80  # Gaussians before the balls, and of each
LARGE = 40  # of the first ball's, which are stretched
# What discs hide may let through what reaches pixels that it had finished: below MIN_TRANSMITTANCE
UNSEEN = 1e-4


def stretched(*, seed: int = 0) -> Splats:
    """The still life with large, long Gaussians of any direction in the first ball."""
    generator = torch.Generator().manual_seed(seed)
    scales, quats = SPLATS.scales.clone(), SPLATS.quats.clone()
    large = slice(TABLE, TABLE + LARGE)
    scales[large] = torch.tensor([0.2, 0.1, 0.02]).log() + 0.2 * torch.randn(
        LARGE, 3, generator=generator
    )
    quats[large] = torch.randn(LARGE, 4, generator=generator)
    opacities = 2 * torch.randn(len(SPLATS), generator=generator) + 1
    shN = 0.1 * torch.randn(len(SPLATS), 3, 3, generator=generator)
    confidence = torch.rand(len(SPLATS), generator=generator)
    return replace(
        SPLATS, scales=scales, quats=quats, opacities=opacities, shN=shN, confidence=confidence
    )


SCENE = stretched()
ROWS = torch.arange(len(SCENE))
PICKED = (ROWS >= TABLE) & (ROWS < TABLE + BALL)
