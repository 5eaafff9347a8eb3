"""The objective of the optimisation: style, form, content, palette and large shapes."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from stylesplat.imaging.color import Palette
from stylesplat.rendering.render import render
from stylesplat.scene.splats import Splats
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.form import (
    FormBand,
    FormSurvey,
    PooledMask,
    form_distance,
    measure_form,
)
from stylesplat.stylization.matching import Potentials, StyleIndex, cosine_distance
from stylesplat.stylization.views import ObjectView, per_view

PULL = 10.0  # weight of the squared distance from the palette; more costs style
HOLD = 5.0  # weight of the squared change of large shapes; 50 leaves fine strokes no room
FORM = 0.13  # weight of the form at 1; at .1 the content SSIM of fox is .01 less
EVEN = 0.1  # weight at which an object changes half as much; demo's vase: 0.22, of 0.34 to 0.08
MOST_CONTENT = 0.98  # a larger weight of content keeps no more of it
SIDE = 4  # pixels of a view that make one in which large shapes are compared


@dataclass(frozen=True, eq=False)
class ViewTarget:
    """A view to paint in, and what the paint is compared with there; None leaves it free."""

    view: ObjectView
    cells: tuple[Int[Tensor, " P"], ...]
    """The rows and columns of the features that are the object's."""
    form: tuple[PooledMask, Sequence[FormBand]] | None = None
    """That of the unpainted object, and the pixels in which it is measured."""
    content: Float[Tensor, "P D"] | None = None
    """The features of the unpainted object."""
    shapes: Float[Tensor, "3 h w"] | None = None
    """The large shapes of the paint so far."""


@dataclass(frozen=True, eq=False)
class Objective:
    """The losses of one object and style."""

    network: FeatureNetwork
    style: StyleIndex
    """The features of the style."""
    config: StyleConfig
    """The network's block, and the weights."""
    length: float
    """The whole object's longer side in the views, in pixels."""
    form: FormSurvey
    palette: Palette | None = None
    """The colours to stay near to; None leaves them free."""

    @torch.no_grad()
    def targets(
        self, views: Sequence[ObjectView], original: Splats, painted: Splats | None
    ) -> list[ViewTarget]:
        """What the paint is compared with in each view.

        The unpainted scene need not have the same Gaussians as the painted one, whose large shapes
        are to stay; None leaves them free.
        """

        def look(view: ObjectView) -> ViewTarget:
            cells = view.cells.nonzero(as_tuple=True)
            form = content = None
            if self.config.form > 0 or self.config.content > 0:
                image, _ = render(original, view.camera)
                if self.config.form > 0:
                    own = PooledMask.of(view.pixels, self.length)
                    bands = measure_form(own.average(image), own.mask, own.length, self.form)
                    form = own, bands
                if self.config.content > 0:
                    content = self._features(image, cells)
            shapes = None if painted is None else _large_shapes(view, view.render(painted))
            return ViewTarget(view, cells, form, content, shapes)

        return [*per_view(look, views, "measuring the form", original.device)]

    def __call__(
        self, target: ViewTarget, splats: Splats, potentials: Potentials | None = None
    ) -> tuple[Float[Tensor, ""], Float[Tensor, ""], Potentials]:
        """The losses of splats in one view.

        Args:
            target: The view.
            splats: The scene as it is painted.
            potentials: Those of the step before, if there was one.

        Returns:
            NNFM of the object's own features; its sum with form, content, large shapes and the
            distance from the palette; and the potentials for the next step.
        """
        view = target.view
        image = view.render(splats)
        feats = self._features(image, target.cells)
        if potentials is None:
            potentials = self.style.no_favour()
        matches, potentials = self.style.nearest(feats.detach(), potentials)
        nnfm = total = cosine_distance(feats, self.style.directions.index_select(0, matches))
        if target.form is not None:
            own, bands = target.form
            distance = form_distance(own.average(image), own.mask, own.length, bands)
            total = total + FORM * self.config.form * distance
        if target.content is not None:
            before = target.content.float()
            change = (feats.float() - before).square().mean() / before.square().mean()
            total = total + content_weight(self.config.content) * change
        if self.palette is not None:
            total = total + PULL * self.palette.distance(image, view.pixels)
        if target.shapes is not None:
            # both hold 0 outside the object
            change = (_large_shapes(view, image) - target.shapes).square().sum()
            total = total + HOLD * change * SIDE**2 / view.pixels.sum()
        return nnfm, total, potentials

    def _features(self, image: Tensor, cells: tuple[Tensor, ...]) -> Float[Tensor, "P D"]:
        return self.network(image, [self.config.block])[0][cells]


def content_weight(content: float) -> float:
    """The weight of the change of features, so that a setting of 0 to 1 has an even effect."""
    share = min(content, MOST_CONTENT)
    return EVEN * share / (1 - share)


def _large_shapes(view: ObjectView, image: Float[Tensor, "H W 3"]) -> Float[Tensor, "3 h w"]:
    """The object's pixels, averaged over squares."""
    own = image * view.pixels[..., None]
    return F.avg_pool2d(own.permute(2, 0, 1)[None], SIDE, ceil_mode=True)[0]
