"""Keeping the large shapes that coarse stages found while fine ones give strokes their edges."""

import math
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.scene.splats import Splats
from stylesplat.stylization.object_views import ObjectView, ViewKey

SIDE = 4  # pixels of a view that make one in which shapes are compared


@dataclass(frozen=True)
class Anchor:
    """What an object looked like when its large shapes had been found."""

    splats: Splats
    """In the colours that it had then."""
    known: dict[ViewKey, Tensor] = field(default_factory=dict)
    """The large shapes of the views seen so far."""
    room: float = math.inf
    """Bytes that these may take; what does not fit is computed in every step."""

    def distance(self, view: ObjectView, image: Float[Tensor, "H W 3"]) -> Float[Tensor, ""]:
        """The mean squared change of the object's large shapes in one view."""
        before = self.known.get(view.key)
        if before is None:
            with torch.no_grad():
                before = _shapes(view.render(self.splats), view)
            if sum(each.nbytes for each in self.known.values()) + before.nbytes <= self.room:
                self.known[view.key] = before
        # both hold 0 outside the object
        return (_shapes(image, view) - before).square().sum() * SIDE**2 / view.pixels.sum()


def _shapes(image: Tensor, view: ObjectView) -> Float[Tensor, "3 h w"]:
    """The object's pixels, averaged over squares."""
    own = image * view.pixels[..., None]
    return F.avg_pool2d(own.permute(2, 0, 1)[None], SIDE, ceil_mode=True)[0]
