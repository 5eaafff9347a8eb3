"""What an object's colours are optimised for: style, and as much content and calm as wanted."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.scene.splats import Splats
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.matching import StyleIndex
from stylesplat.stylization.nnfm import cosine_distance
from stylesplat.stylization.object_views import ObjectView
from stylesplat.stylization.style_config import StyleConfig

SHAPES = 16  # pixels; what is larger is a shape that the stages before have found
SHAPES_WEIGHT = 10.0  # keeps them, and leaves strokes as they would be
Place = tuple[float, ...]


@dataclass(frozen=True)
class Losses:
    """The parts of the objective in one view."""

    style: Float[Tensor, ""]
    """NNFM over the object's own features, averaged over the layer groups."""
    total: Float[Tensor, ""]
    """With the weighted content and total variation."""


@dataclass(frozen=True)
class Objective:
    """The losses of one object and style."""

    network: FeatureNetwork
    """Whose features are matched."""
    styles: Sequence[StyleIndex]
    """The features of the style, for each layer group."""
    original: Splats
    """What `content` compares with."""
    config: StyleConfig
    """The layers and weights."""
    shapes: Splats | None = None
    """Whose large shapes are to stay; None keeps none."""
    kept: dict[Place, Tensor] = field(default_factory=dict)
    """These shapes in the pictures seen so far."""
    wanted: dict[Place, list[Tensor]] = field(default_factory=dict)
    """The original's features in the pictures seen so far, for `content`."""

    def __call__(self, view: ObjectView, splats: Splats) -> Losses:
        """The losses of splats in one view."""
        image = view.render(splats)
        feats = self._features(view, image)
        pairs = zip(feats, self.styles, strict=True)
        matched = [
            cosine_distance(own, style.directions[style.nearest(own.detach())])
            for own, style in pairs
        ]
        style = total = torch.stack(matched).mean()
        if self.shapes is not None:
            total = total + SHAPES_WEIGHT * self._lost_shapes(view, image, self.shapes)
        if self.config.content > 0:
            total = total + self.config.content * self._content(view, feats)
        if self.config.smoothness > 0:
            variation = total_variation(image, view.pixels)
            total = total + self.config.smoothness * variation
        return Losses(style, total)

    def _features(self, view: ObjectView, image: Tensor) -> list[Tensor]:
        blocks = self.network(image, self.config.layers)
        return [block[cells] for block, cells in zip(blocks, view.cells, strict=True)]

    def _lost_shapes(self, view: ObjectView, image: Tensor, before: Splats) -> Tensor:
        """The mean squared change of what is left of the picture if it is blurred."""
        place = _place(view)
        if place not in self.kept:
            with torch.no_grad():
                self.kept[place] = _blurred(view.render(before))
        return (_blurred(image) - self.kept[place]).square().mean()

    def _content(self, view: ObjectView, feats: Sequence[Tensor]) -> Tensor:
        """The mean squared change of the features, in units of their mean square."""
        place = _place(view)
        wanted = self.wanted.get(place)
        if wanted is None:
            with torch.no_grad():
                as_it_was = view.with_fixed_bands(self.original)  # the view may have others
                image = as_it_was.render(self.original)
                wanted = self.wanted[place] = self._features(view, image)
        changes = [
            (own.float() - other.float()).square().mean() / other.float().square().mean()
            for own, other in zip(feats, wanted, strict=True)
        ]
        return torch.stack(changes).mean()


def _place(view: ObjectView) -> Place:
    """What tells a view from others, which may see parts of the same photo."""
    camera = view.camera
    return (*camera.viewmats.flatten().tolist(), *camera.Ks.flatten().tolist())


def _blurred(image: Tensor) -> Tensor:
    return F.avg_pool2d(image.permute(2, 0, 1), SHAPES, ceil_mode=True)


def total_variation(image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"]) -> Float[Tensor, ""]:
    """The mean absolute difference of neighbouring pixels that both lie in the mask."""
    down = (image[1:] - image[:-1]).abs()[mask[1:] & mask[:-1]]
    right = (image[:, 1:] - image[:, :-1]).abs()[mask[:, 1:] & mask[:, :-1]]
    return torch.cat([down, right]).mean()
