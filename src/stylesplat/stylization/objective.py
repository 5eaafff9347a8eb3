"""What an object's colours are optimised for: style, and as much content and calm as wanted."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.scene.cache import size_of
from stylesplat.scene.splats import Splats
from stylesplat.stylization.anchor import Anchor
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.matching import StyleIndex
from stylesplat.stylization.near_palette import NearPalette
from stylesplat.stylization.nnfm import cosine_distance
from stylesplat.stylization.object_views import ObjectView, ViewKey
from stylesplat.stylization.style_config import StyleConfig

PULL = 10.0  # weight of the squared way back to the painting's colours; more costs style
HOLD = 5.0  # weight of the squared change of large shapes; 50 leaves fine strokes no room
EVEN = 0.1  # weight at which an object changes half as much; demo's vase: 0.22, of 0.34 to 0.08
MOST_CONTENT = 0.98  # a larger weight of content keeps no more of it


@dataclass(frozen=True)
class Losses:
    """The parts of the objective in one view."""

    style: Float[Tensor, ""]
    """NNFM over the object's own features, averaged over the layer groups."""
    total: Float[Tensor, ""]
    """With the weighted content, total variation and distance from the palette."""


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
    near: NearPalette | None = None
    """The colours to stay near to; None leaves them free."""
    anchor: Anchor | None = None
    """The large shapes to keep; None leaves them free."""
    wanted: dict[ViewKey, list[Tensor]] = field(default_factory=dict)
    """The original's features in the pictures seen so far, for `content`."""
    room: float = math.inf
    """Bytes that these may take; what does not fit is computed in every step."""

    def __call__(self, view: ObjectView, splats: Splats) -> Losses:
        """The losses of splats in one view."""
        image = view.render(splats)
        feats = self._features(view, image)
        pairs = zip(feats, self.styles, strict=True)
        matched = [
            cosine_distance(own, style.directions.index_select(0, style.nearest(own.detach())))
            for own, style in pairs
        ]
        style = total = torch.stack(matched).mean()
        if self.config.content > 0:
            total = total + content_weight(self.config.content) * self._content(view, feats)
        if self.config.smoothness > 0:
            variation = total_variation(image, view.pixels)
            total = total + self.config.smoothness * variation
        if self.near is not None:
            total = total + PULL * self.near.distance(image, view.pixels)
        if self.anchor is not None:
            total = total + HOLD * self.anchor.distance(view, image)
        return Losses(style, total)

    def _features(self, view: ObjectView, image: Tensor) -> list[Tensor]:
        blocks = self.network(image, self.config.layers)
        return [block[cells] for block, cells in zip(blocks, view.cells, strict=True)]

    def _content(self, view: ObjectView, feats: Sequence[Tensor]) -> Tensor:
        """The mean squared change of the features, in units of their mean square."""
        key = view.key
        wanted = self.wanted.get(key)
        if wanted is None:
            with torch.no_grad():
                as_it_was = view.with_fixed_bands(self.original)  # the view may have others
                image = as_it_was.render(self.original)
                wanted = self._features(view, image)
            used = sum(size_of(tuple(each)) for each in self.wanted.values())
            if used + size_of(tuple(wanted)) <= self.room:
                self.wanted[key] = wanted
        changes = [
            (own.float() - other.float()).square().mean() / other.float().square().mean()
            for own, other in zip(feats, wanted, strict=True)
        ]
        return torch.stack(changes).mean()


def content_weight(content: float) -> float:
    """What the change of features costs, in units of NNFM: so that a setting of 0 to 1 is even.

    Half-way between no features and all that can be kept lies `EVEN`.

    Example:
        >>> content_weight(0.0), content_weight(0.5)
        (0.0, 0.1)
    """
    share = min(content, MOST_CONTENT)
    return EVEN * share / (1 - share)


def total_variation(image: Float[Tensor, "H W 3"], mask: Bool[Tensor, "H W"]) -> Float[Tensor, ""]:
    """The mean absolute difference of neighbouring pixels that both lie in the mask."""
    down = (image[1:] - image[:-1]).abs()[mask[1:] & mask[:-1]]
    right = (image[:, 1:] - image[:, :-1]).abs()[mask[:, 1:] & mask[:, :-1]]
    return torch.cat([down, right]).mean()
