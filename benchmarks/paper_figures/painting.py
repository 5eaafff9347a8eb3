"""Objects painted as the paper does it and as we do."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any
from unittest import mock

import torch
from torch import Tensor

from paper_figures.subject import Subject
from stylesplat.scene.layers import Composed
from stylesplat.stylization import optimize
from stylesplat.stylization.config import STYLE_PRESETS, StyleConfig
from stylesplat.stylization.painter import paint_objects, paint_setup
from stylesplat.stylization.painting import Painting


def default_config(subject: Subject) -> StyleConfig:
    """Our default settings; their draft, which splits nothing, where effort is small."""
    return StyleConfig(quality="draft") if subject.effort.draft else STYLE_PRESETS["default"]


def paper_config(subject: Subject, lr: float = 0.05) -> StyleConfig:
    """The paper's settings, with a rate of its Figure 6."""
    return replace(STYLE_PRESETS["paper"], steps=subject.effort.steps, lr=lr)


def painted(
    subject: Subject,
    styles: Mapping[int, Tensor],
    config: StyleConfig,
    *,
    side: int | None = None,
) -> Composed:
    """Some objects in a style each, from the training views, this long if that is said."""
    views = subject.training if side is None else subject.training.at_most(side)
    studio = paint_setup(subject.splats, views, subject.network, held_out=subject.held_out)
    jobs = [
        Painting(subject.called(id), subject.picked(id), (style,), config)
        for id, style in styles.items()
    ]
    return paint_objects(studio, jobs)


@contextmanager
def few_style_features() -> Iterator[None]:
    """Of more features of a style than the package takes in its last stage, as many at random.

    The layers [1,3] have as many as the picture has pixels: matching all would take a day.
    """
    every = optimize.target_features
    generator = torch.Generator().manual_seed(0)

    def some(*arguments: Any) -> Tensor:
        feats = every(*arguments)
        return feats[torch.randperm(len(feats), generator=generator)[: optimize.STYLE_FEATURES]]

    with mock.patch.object(optimize, "target_features", some):
        yield
