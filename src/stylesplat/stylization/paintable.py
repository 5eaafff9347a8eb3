"""An object as it is painted: the Gaussians that are its own, with or without a canvas."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import say
from stylesplat.scene.compose import UNSEEN
from stylesplat.scene.splats import Splats
from stylesplat.selection.soft_picks import own_shares
from stylesplat.stylization.canvas import Canvas, lay_canvas
from stylesplat.stylization.confine import confine_canvas
from stylesplat.stylization.fit_canvas import fit_canvas
from stylesplat.stylization.target import PaintContext, PaintTarget
from stylesplat.stylization.views import Box, require_boxes

OWN = 0.5  # share of a Gaussian that is the object's: one with less is not painted


@dataclass(frozen=True)
class Paintable:
    """The Gaussians that carry an object's paint."""

    context: PaintContext
    """Its scene is the one that is painted."""
    target: PaintTarget
    """Its mask has the Gaussians that are painted."""
    parents: Int[Tensor, " N"]
    """The Gaussian of the scene before that each one belongs to."""
    canvas: Canvas | None = None
    bare: "Paintable | None" = None
    """The object without its canvas."""

    @property
    def splats(self) -> Splats:
        """The scene."""
        return self.context.splats

    @property
    def mask(self) -> Bool[Tensor, " N"]:
        """The Gaussians that are painted."""
        return self.target.mask

    @property
    def before(self) -> Splats:
        """The scene before, whose details a canvas blurs."""
        return (self.bare or self).splats

    @property
    def unpainted(self) -> Splats:
        """The same Gaussians as the scene looked before: discs do not show."""
        if self.bare is None:
            return self.splats
        before = self.bare.splats.opacities
        unseen = torch.full_like(self.splats.opacities[len(before) :], UNSEEN)
        return replace(self.splats, opacities=torch.cat([before, unseen]))


def own_gaussians(context: PaintContext, target: PaintTarget) -> Paintable:
    """The object on its own Gaussians, without what lies mostly beside it.

    Raises:
        StyleSplatError: If it is not seen, or nothing is its own.
    """
    splats = context.splats
    everyone = torch.arange(len(splats), device=splats.device)
    if target.config.published:
        return Paintable(context, target, everyone)
    own = replace(target, mask=own_shares(splats, target.mask, context.cameras) > OWN)
    if not own.mask.any():
        require_boxes(context, target, context.cameras)  # else that is why
        raise StyleSplatError(
            f"Cannot stylise {target.name}: most of what each of its Gaussians paints lies where "
            "they cover less than half. Pick more of the object."
        )
    return Paintable(context, own, everyone)


def lay(object: Paintable, boxes: Sequence[Box], length: float) -> Paintable:
    """Lay a canvas on the object, if it is to have one and has a surface for it.

    Args:
        object: On its own Gaussians.
        boxes: Where it is seen.
        length: Its longer side in pixels that discs are to be fine enough for.
    """
    config = object.target.config
    max_discs = config.max_discs(int(object.mask.sum()))
    if max_discs == 0 or config.intensity == 0:
        return object
    # contributions are known on the CPU only
    splats, mask = object.splats.to("cpu"), object.mask.cpu()
    rest = {"length": length, "max_discs": max_discs, "seed": config.seed}
    canvas = lay_canvas(splats, mask, boxes, **rest)
    if canvas is None:
        say(f"{object.target.name} has no surface for a canvas: its own Gaussians are painted.")
        return object
    return _with_canvas(object, fit_canvas(splats, canvas, mask, boxes, seed=config.seed))


def confine(
    object: Paintable, boxes: Sequence[Box], painted: Splats | None
) -> tuple[Paintable, Bool[Tensor, " N"]]:
    """Turn the canvas's discs along the strokes, and let none show beside the object.

    Args:
        object: With a canvas.
        boxes: Where it is seen.
        painted: The same Gaussians in the colours of the strokes; None leaves discs round.

    Returns:
        The object, and which of its Gaussians are left.
    """
    bare, canvas = object.bare, object.canvas
    assert bare is not None and canvas is not None
    splats, mask = bare.splats.to("cpu"), bare.mask.cpu()
    painted, cameras = painted and painted.to("cpu"), object.context.all_cameras
    canvas, kept = confine_canvas(splats, canvas, mask, boxes, cameras, painted=painted)
    return _with_canvas(bare, canvas), kept.to(object.splats.device)


def _with_canvas(object: Paintable, canvas: Canvas) -> Paintable:
    device = object.splats.device
    splats, parents = canvas.splats.to(device), canvas.parents.to(device)
    target = replace(object.target, mask=object.mask[parents])
    return Paintable(replace(object.context, splats=splats), target, parents, canvas, object)
