"""The best that any 3D result could do in one view: its pixels, optimised with the same loss."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.progress import track
from stylesplat.rendering.shares import COVERED
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.color import color_map
from stylesplat.stylization.features.network import Cells
from stylesplat.stylization.object_views import ObjectView
from stylesplat.stylization.objective import Objective

RATE, LAST_RATE = 0.02, 0.1  # of Adam on colours in 0..1; the last one as a share of the first


@dataclass(frozen=True)
class Sight:
    """An object in one view at the photo's size."""

    camera: Cameras
    """The camera, cut to the object."""
    share: Float[Tensor, "H W 1"]
    """The object's share of every pixel."""
    before: Float[Tensor, "H W 3"]
    """What shows in the scene, in 0..1."""


@dataclass(frozen=True)
class Canvas(ObjectView):
    """A view whose pixels are what they are, whatever the splats."""

    colors: Tensor | None = None
    """[H, W, 3]."""

    def render(self, splats: Splats) -> Float[Tensor, "H W 3"]:
        """The pixels."""
        assert self.colors is not None
        return self.colors


def canvas(
    sight: Sight, image: Float[Tensor, "H W 3"], size: float, cells: Sequence[Cells]
) -> Canvas:
    """A picture of the object, smaller than the photo, for whoever compares features."""
    colors, share = _smaller(image, size), _smaller(sight.share, size)[..., 0]
    masks = tuple(F.avg_pool2d(share[None], c.stride)[0] > COVERED for c in cells)
    return Canvas(sight.camera, masks, share > COVERED, colors=colors)


def target_2d(
    sight: Sight,
    palette: Float[Tensor, "Q 3"],
    objectives: Sequence[tuple[float, Objective]],
    steps: int,
) -> Float[Tensor, "H W 3"]:
    """The view with the object's pixels as free as can be.

    They start from the palette's mean and covariance, and end there, as splats do. Every step adds
    the losses at all sizes. What the object covers in part is blended with what is there.

    Args:
        sight: The view.
        palette: The pictures' colours, in 0..1.
        objectives: Sizes, as shares of the photo's, and the loss there.
        steps: Of Adam.
    """
    leaf = _matched(sight, sight.before, palette).requires_grad_()
    optimizer = torch.optim.Adam([leaf], lr=RATE)
    scheduler = torch.optim.lr_scheduler.ExponentialLR(optimizer, LAST_RATE ** (1 / steps))
    for _ in track(range(steps), "painting the pixels"):
        optimizer.zero_grad()
        shown = sight.before.lerp(leaf, sight.share)
        losses = [
            each(canvas(sight, shown, size, _cells(each)), each.original).total
            for size, each in objectives
        ]
        torch.stack(losses).sum().backward()
        optimizer.step()
        scheduler.step()
        leaf.data.clamp_(0, 1)
    return sight.before.lerp(_matched(sight, leaf.detach(), palette), sight.share)


def _matched(sight: Sight, image: Tensor, palette: Tensor) -> Tensor:
    """A picture with the palette's mean and covariance where the object is."""
    matrix, offset = color_map(image[sight.share[..., 0] > COVERED], palette)
    return (image @ matrix.T + offset).clamp(0, 1)


def _cells(objective: Objective) -> list[Cells]:
    return [objective.network.cells(block) for block in objective.config.layers]


def _smaller(image: Float[Tensor, "H W D"], size: float) -> Float[Tensor, "_ _ D"]:
    if size == 1:
        return image
    height, width = (max(1, round(size * side)) for side in image.shape[:2])
    planes = image.permute(2, 0, 1)[None]
    small = F.interpolate(planes, (height, width), mode="bilinear", antialias=True)
    return small[0].permute(1, 2, 0)
