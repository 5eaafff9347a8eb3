"""Layers of random paint, made without painting."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from scenes import random_splats
from stylesplat.scene.layer import Layer, Source, without_identities
from stylesplat.scene.splats import Splats

SETTINGS = {"steps": 5, "scale": 2.0, "layers": [3], "intensity": 1.0}


def plain_layer(
    base: Splats, rows: torch.Tensor, name: str, *, canvas: int = 0, seed: int = 0, **fields: Any
) -> Layer:
    """A layer on some rows, with so many new Gaussians, half of whose rows fade."""
    generator = torch.Generator().manual_seed(seed)
    bands, count = base.shN.shape[1:], len(rows)

    def noise(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    factors = torch.rand(count, generator=generator)
    new = without_identities(random_splats(canvas, seed=seed + 1))
    new = replace(new, shN=0.1 * noise(canvas, *bands))
    picks = torch.randint(count, (canvas,), generator=generator)
    layer = Layer(
        object=name,
        rows=rows,
        shares=torch.rand(count, generator=generator),
        sh0=noise(count, 1, 3),
        shN=noise(count, *bands),
        opacity_factors=torch.where(torch.arange(count) % 2 == 0, factors, 1.0),
        canvas=new,
        canvas_sh0=noise(canvas, 1, 3),
        parents=rows[picks],
        relief=noise(count + canvas).clamp(-1, 1) / 5,
        styles=(Source(Path("/pictures/wave.jpg"), "12ab"),),
        settings=SETTINGS,
    )
    return replace(layer, **fields)


def layer_towards(base: Splats, shown: Splats, picked: torch.Tensor, name: str) -> Layer:
    """The layer that gives picked rows the colours and opacities of other splats."""
    rows = picked.nonzero()[:, 0]
    nothing = without_identities(base[rows[:0]])
    factors = torch.sigmoid(shown.opacities[rows]) / torch.sigmoid(base.opacities[rows])
    return Layer(
        object=name,
        rows=rows,
        shares=torch.ones(len(rows)),
        sh0=shown.sh0[rows],
        shN=shown.shN[rows],
        opacity_factors=factors.clamp(max=1),
        canvas=nothing,
        canvas_sh0=nothing.sh0,
        parents=rows[:0],
        relief=torch.zeros(len(rows)),
    )
