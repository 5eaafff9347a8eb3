"""The optimisation of colours in one stage: its objective and its steps.

The objective is of rendered images: style (NNFM), form, content, palette and large shapes. The
steps move the colours of whatever views render: an object's Gaussians, or the texels of a mesh.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from stylesplat.imaging.color import Palette
from stylesplat.rendering.render import render
from stylesplat.rendering.view_pool import per_view
from stylesplat.scene.sequences import shuffled_repeats
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.stylization.colors import DARKEST, Colors
from stylesplat.stylization.config import Stage, StyleConfig
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.form import (
    FormSurvey,
    FormTarget,
    PooledMask,
    form_distance,
    measure_form,
)
from stylesplat.stylization.guides import GUIDED_LEAST, Guides, TurnedStyle, turned_style
from stylesplat.stylization.matching import (
    Potentials,
    StyleIndex,
    build_index,
    cosine_distance_of_units,
    unit_rows,
)
from stylesplat.stylization.painting import PaintSetup
from stylesplat.stylization.style import style_features, style_parts
from stylesplat.stylization.views import PaintView, total_weights
from stylesplat.training.adam import Moments, adam_step

PULL = 10.0  # weight of the squared distance from the palette; more costs style
HOLD = 5.0  # weight of the squared change of large shapes; 50 leaves fine strokes no room
# Weight of the form at 1: at .13 a local correlation with the unpainted object is .01 less on a
# fox, a biker and a bottle, and NNFM the same
FORM = 0.2
# Weight at which an object changes half as much; demo's vase: 0.22, of 0.34 to 0.08
OPTIMIZE_EVEN = 0.1
MOST_CONTENT = 0.98  # a larger weight of content keeps no more of it
LARGE_SHAPE_SIDE = 4  # pixels of a view that make one in which large shapes are compared
CANVAS_RATE = 0.5  # factor of the rate on a canvas: a pixel shows few discs, and more looks grainy
STYLE_FEATURES = 2048  # at random, of those of a fine stage; 4,096 look the same, and take longer
FINAL_RATE = 0.1  # of the last step, as a share of the first's
TRUSTED = 0.25  # of the median weight: Gaussians that show less take smaller steps


@dataclass(frozen=True, eq=False)
class ViewTarget:
    """A view to paint in, and what the paint is compared with there; None leaves it free."""

    view: PaintView
    cells: Int[Tensor, " P"]
    """Which features are the object's, row by row."""
    area: int
    """The object's pixels."""
    form: tuple[PooledMask, FormTarget] | None = None
    """That of the unpainted object, and the pixels in which it is measured."""
    content: Float[Tensor, "P D"] | None = None
    """The features of the unpainted object."""
    shapes: Float[Tensor, "3 h w"] | None = None
    """The large shapes of the paint so far."""
    flow: Float[Tensor, "P 2"] | None = None
    """How strokes are to run; see `Guides.flow`."""


@dataclass(frozen=True, eq=False)
class Objective:
    """The losses of one object and style."""

    network: FeatureNetwork
    style: StyleIndex
    """The features of the style."""
    config: StyleConfig
    """The network's block, the weights, and the rate of this stage."""
    length: float
    """The whole object's longer side in the views, in pixels."""
    form: FormSurvey
    palette: Palette | None = None
    """The colours to stay near to; None leaves them free."""
    guides: Guides | None = None
    turned: TurnedStyle | None = None
    """The features for strokes that follow the guides."""

    @torch.no_grad()
    def targets(
        self, views: Sequence[PaintView], original: Splats, painted: Colors | None
    ) -> list[ViewTarget]:
        """What the paint is compared with in each view.

        The `original` is the unpainted scene; the large shapes of `painted` colours are to stay.
        """
        around = self.guides and self.guides.tensors(original.means)

        def look(view: PaintView) -> ViewTarget:
            cells, area = view.cells.flatten().nonzero()[:, 0], int(view.pixels.sum())
            form = content = None
            if self.config.form > 0 or self.config.content > 0:
                image, _ = render(original, view.camera)
                if self.config.form > 0:
                    own = PooledMask.of(view.pixels, self.length)
                    found = measure_form(own.average(image), own.mask, own.length, self.form)
                    form = own, found
                if self.config.content > 0:
                    content = self._features(image, cells)
            shapes = None if painted is None else _large_shapes(view, view.render(painted))
            flow = None
            if self.guides is not None and around is not None:
                pixels = self.guides.flow(original, view.camera, around).permute(2, 0, 1)[None]
                stride = self.network.cells(self.config.block).stride
                flow = F.avg_pool2d(pixels, stride)[0].flatten(1).T.index_select(0, cells)
            return ViewTarget(view, cells, area, form, content, shapes, flow)

        return [*per_view(look, views, "measuring the form", original.device)]

    def __call__(
        self,
        target: ViewTarget,
        image: Float[Tensor, "H W 3"],
        potentials: Potentials | None = None,
    ) -> tuple[Float[Tensor, ""], Float[Tensor, ""], Potentials]:
        """The losses of one view, by its render with the paint and the potentials before.

        Returns NNFM of the object's own features; its sum with form, content, large shapes and the
        distance from the palette; and the potentials for the next step.
        """
        view, feats = target.view, self._features(image, target.cells)
        if potentials is None:
            potentials = self.style.no_favour()
        matches, potentials = self.style.nearest(feats.detach(), potentials)
        wanted = self.style.units.index_select(0, matches)
        if self.turned is not None and target.flow is not None:
            rows = (target.flow.norm(dim=1) > GUIDED_LEAST).nonzero()[:, 0]
            own = feats.detach()[rows], target.flow[rows]
            turned = self.turned.nearest(*own, potentials.favour)
            wanted = wanted.index_copy(0, rows, unit_rows(turned))
        nnfm = total = cosine_distance_of_units(unit_rows(feats), wanted)
        if target.form is not None:
            own, form = target.form
            distance = form_distance(own.average(image), own.length, form)
            total = total.add(distance, alpha=FORM * self.config.form)
        if target.content is not None:
            before = target.content.float()
            change = (feats.float() - before).square().mean() / before.square().mean()
            total = total + content_weight(self.config.content) * change
        if self.palette is not None:
            distance = self.palette.distance(image, view.pixels, target.area)
            total = total.add(distance, alpha=PULL)
        if target.shapes is not None:
            # both hold 0 outside the object
            change = F.mse_loss(_large_shapes(view, image), target.shapes, reduction="sum")
            total = total + HOLD * LARGE_SHAPE_SIDE**2 * change / target.area
        return nnfm, total, potentials

    def _features(self, image: Tensor, cells: Int[Tensor, " P"]) -> Float[Tensor, "P D"]:
        features = self.network(image, [self.config.block])[0]
        return features.flatten(0, 1).index_select(0, cells)


def content_weight(content: float) -> float:
    """The weight of the change of features, so that a setting of 0 to 1 has an even effect."""
    share = min(content, MOST_CONTENT)
    return OPTIMIZE_EVEN * share / (1 - share)


def _large_shapes(view: PaintView, image: Float[Tensor, "H W 3"]) -> Float[Tensor, "3 h w"]:
    """The object's pixels, averaged over squares."""
    own = image * view.pixels[..., None]
    return F.avg_pool2d(own.permute(2, 0, 1), LARGE_SHAPE_SIDE, ceil_mode=True)


def stage_objective(
    setup: PaintSetup,
    config: StyleConfig,
    images: Sequence[Tensor],
    stage: Stage,
    form: FormSurvey,
    palette: Palette | None,
    *,
    rate: float = 1.0,
    balanced: bool = True,
    guides: Guides | None = None,
) -> Objective:
    """The objective of a stage, with a factor on its rate; see `StyleIndex` for `balanced`."""
    network = setup.network.to(setup.splats.device, setup.precision)
    features = target_features(network, config, images, stage.length)
    if stage.fine:
        generator = torch.Generator().manual_seed(config.seed)
        features = features[torch.randperm(len(features), generator=generator)[:STYLE_FEATURES]]
    index, turned = build_index(features, setup.precision, balanced=balanced), None
    if guides is not None:
        turned = turned_style(network, config, images, stage.length, index)
    return Objective(
        network=network,
        style=index,
        config=replace(config, lr=stage.rate * rate * config.lr),
        length=stage.length,
        form=form,
        palette=palette,
        guides=guides,
        turned=turned,
    )


def target_features(
    network: FeatureNetwork, config: StyleConfig, images: Sequence[Tensor], length: float
) -> Float[Tensor, "Q D"]:
    """The features of all style images together, beside an object so long."""
    parts = style_parts(images, config, length)
    return torch.cat([style_features(part, network, config.block, length=n) for part, n in parts])


def optimize_colors(
    colors: Colors, targets: Sequence[ViewTarget], objective: Objective, steps: int, *, seed: int
) -> Iterator[tuple[Colors, Float[Tensor, ""]]]:
    """Move colours until the object's features match the style's.

    Each step draws one of the targets. Yields the colours after every step, and the NNFM before it.
    """
    generator = torch.Generator().manual_seed(seed)
    weights = total_weights([target.view for target in targets])
    trust = (weights / (weights + TRUSTED * weights[weights > 0].median()))[:, None]
    # colours that the rasteriser clamps at 0 would have no gradient to come back by
    darkest, brightest = sh0_from_rgb(torch.tensor([[DARKEST], [1.0]]).expand(2, 3)).to(colors)
    leaf = colors.clone().requires_grad_()
    moments, potentials = Moments.zeros({"sh0": leaf}), None
    everyone = torch.ones(len(colors), dtype=torch.bool, device=colors.device)
    before = colors
    for number, target in enumerate(shuffled_repeats(targets, steps, generator), start=1):
        with torch.enable_grad():  # the caller may have disabled it
            nnfm, total, potentials = objective(target, target.view.render(leaf), potentials)
            total.backward()
        rate = objective.config.lr * FINAL_RATE ** ((number - 1) / steps)
        adam_step({"sh0": leaf}, moments, {"sh0": rate}, number, visible=everyone)
        with torch.no_grad():  # Adam's steps are as long for Gaussians that hardly show
            before = before.lerp(leaf, trust).clamp_(darkest, brightest)
            leaf.copy_(before)
        leaf.grad = None
        yield before, nnfm.detach()
