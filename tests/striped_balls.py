"""The balls with colours that depend on the view, and how one of them is quickly painted."""

from dataclasses import replace

import torch

from balls import SPLATS
from stylesplat.scene.splats import Splats
from stylesplat.stylization.style_config import StyleConfig
from stylesplat.stylization.style_job import StyleJob

FAST = StyleConfig(steps=12, layers=(2,), scale=1.5, object_size=24, max_growth=1.0)
BANDS = 0.1 * torch.randn(len(SPLATS), 3, 3, generator=torch.Generator().manual_seed(0))
SCENE = replace(SPLATS, shN=BANDS)
TABLE = 200  # Gaussians before the balls' 80 each
GROWN = 2.5  # cap of the tests that lay a canvas


def ball(number: int) -> torch.Tensor:
    picked = torch.zeros(len(SCENE), dtype=torch.bool)
    picked[TABLE + 80 * number : TABLE + 80 * (number + 1)] = True
    return picked


def same(one: Splats, other: Splats) -> bool:
    return all(torch.equal(t, other.tensors()[name]) for name, t in one.tensors().items())


def with_settings(job: StyleJob, **settings) -> StyleJob:
    return replace(job, config=replace(job.config, **settings))
