"""The balls with colours that depend on the view, and how one of them is quickly painted."""

from dataclasses import replace

import torch

from balls import SPLATS
from stylesplat.scene.splats import Splats
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.target import PaintTarget

FAST = StyleConfig(steps=12, layers=(2,), scale=1.5, object_size=24, quality="draft")
BANDS = 0.1 * torch.randn(len(SPLATS), 3, 3, generator=torch.Generator().manual_seed(0))
SCENE = replace(SPLATS, shN=BANDS)
TABLE = 200  # Gaussians before the balls' 80 each


def ball(number: int) -> torch.Tensor:
    picked = torch.zeros(len(SCENE), dtype=torch.bool)
    picked[TABLE + 80 * number : TABLE + 80 * (number + 1)] = True
    return picked


def same(one: Splats, other: Splats) -> bool:
    return all(torch.equal(t, other.tensors()[name]) for name, t in one.tensors().items())


def with_settings(job: PaintTarget, **settings) -> PaintTarget:
    return replace(job, config=replace(job.config, **settings))
