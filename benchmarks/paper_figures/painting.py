"""Objects painted as the paper does it and as we do."""

from collections.abc import Mapping
from dataclasses import replace

from torch import Tensor

from paper_figures.subject import Subject
from stylesplat.stylization.paint_objects import Styled, open_studio, paint_objects
from stylesplat.stylization.style_config import PRESETS, StyleConfig
from stylesplat.stylization.style_job import StyleJob


def default_config(subject: Subject) -> StyleConfig:
    """Our default settings; their draft, which splits nothing, where effort is small."""
    return PRESETS["default"] if subject.effort.trained else StyleConfig(quality="draft")


def paper_config(subject: Subject, lr: float = 0.05) -> StyleConfig:
    """The paper's settings, with a rate of its Figure 6."""
    return replace(PRESETS["paper"], steps=subject.effort.steps, lr=lr)


def painted(
    subject: Subject,
    styles: Mapping[int, Tensor],
    config: StyleConfig,
    *,
    side: int | None = None,
) -> Styled:
    """Some objects in a style each, from the training views, this long if that is said."""
    views = subject.training if side is None else subject.training.at_most(side)
    studio = open_studio(subject.splats, views, subject.network, held_out=subject.held_out)
    jobs = [
        StyleJob(subject.called(id), subject.picked(id), (style,), config)
        for id, style in styles.items()
    ]
    return paint_objects(studio, jobs)[0]
