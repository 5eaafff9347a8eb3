"""What an object is painted on: Gaussians that are its own, by shares, and fine enough."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import say
from stylesplat.scene.compose import UNSEEN
from stylesplat.scene.splats import Splats
from stylesplat.selection.contacts import on_support
from stylesplat.selection.soft_picks import Place, find_places, seen_anew, soft_shares
from stylesplat.stylization.canvas import Canvas, confine_canvas, lay_canvas
from stylesplat.stylization.fit_canvas import fit_canvas
from stylesplat.stylization.looking import see_object
from stylesplat.stylization.object_views import Box
from stylesplat.stylization.style_job import Studio, StyleJob


@dataclass(frozen=True)
class Ground:
    """What an object is painted on."""

    studio: Studio
    """Its scene is the one that is painted on."""
    job: StyleJob
    """Its picked Gaussians are those with a share."""
    shares: Float[Tensor, " N"]
    """How much of its paint each Gaussian takes on."""
    parents: Int[Tensor, " N"]
    """The Gaussian of the scene before that each one comes from."""
    places: Sequence[Place]
    """Where the object is in some views, which tells shares; none if all have one of 1."""
    beneath: "Ground | None" = None
    """The object as it is; None if there is no canvas on it."""
    canvas: Canvas | None = None
    """What was laid on that."""

    @property
    def unpainted(self) -> Splats:
        """The same Gaussians as the scene looked before: discs do not show."""
        splats = self.studio.splats
        if self.beneath is None:
            return splats
        before = self.beneath.studio.splats.opacities
        unseen = torch.full_like(splats.opacities[len(before) :], UNSEEN)
        return replace(splats, opacities=torch.cat([before, unseen]))


def own_ground(studio: Studio, job: StyleJob) -> Ground:
    """The object as it is, without what lies on the surface that it stands on.

    Raises:
        StyleSplatError: If it is not seen, or nothing is its own.
    """
    if not job.config.hard:
        support = on_support(studio.splats, job.picked, seed=job.config.seed)
        job = replace(job, picked=job.picked & ~support)
    places = [] if job.config.hard else find_places(studio.splats, job.picked, studio.cameras)
    everyone = torch.arange(len(studio.splats), device=studio.splats.device)
    return _with_shares(studio, job, everyone, places)


def canvas_ground(ground: Ground, boxes: Sequence[Box], length: float) -> Ground:
    """The same with a canvas on it, if the object is to have one, and has a surface for it.

    Args:
        ground: The object as it is.
        boxes: Where it is seen.
        length: Its longer side in pixels, for which discs are to be fine enough.
    """
    config, count = ground.job.config, int(ground.job.picked.sum())
    room = int((config.growth(count) - 1) * count)
    if room == 0 or config.intensity == 0:
        return ground  # nothing would come of it
    # contributions are known on the CPU only
    splats, picked = ground.studio.splats.to("cpu"), ground.job.picked.cpu()
    canvas = lay_canvas(splats, picked, boxes, length=length, room=room, seed=config.seed)
    if canvas is None:
        say(f"{ground.job.name} has no surface for a canvas: its own Gaussians are painted.")
        return ground
    return _on_canvas(ground, fit_canvas(splats, canvas, picked, boxes, seed=config.seed))


def confined_ground(
    ground: Ground, boxes: Sequence[Box], along: Splats | None
) -> tuple[Ground, Bool[Tensor, " N"]]:
    """The same with a canvas that shows nowhere beside the object, and which Gaussians are left.

    Args:
        ground: With a canvas.
        boxes: Where the object is seen.
        along: The same Gaussians with strokes to turn discs along; None leaves them round.
    """
    bare, canvas = ground.beneath, ground.canvas
    assert bare is not None and canvas is not None
    splats, picked = bare.studio.splats.to("cpu"), bare.job.picked.cpu()
    along, cameras = along and along.to("cpu"), ground.studio.every_camera
    canvas, kept = confine_canvas(splats, canvas, picked, boxes, cameras, along=along)
    return _on_canvas(bare, canvas), kept.to(ground.studio.splats.device)


def _on_canvas(ground: Ground, canvas: Canvas) -> Ground:
    """What is painted once there is a canvas on the object."""
    device = ground.studio.splats.device
    splats, parents = canvas.splats.to(device), canvas.parents.to(device)
    job = replace(ground.job, picked=ground.job.picked[parents])
    places = seen_anew(splats, job.picked, ground.places)
    laid = _with_shares(replace(ground.studio, splats=splats), job, parents, places)
    return replace(laid, beneath=ground, canvas=canvas)


def _with_shares(studio: Studio, job: StyleJob, parents: Tensor, places: Sequence[Place]) -> Ground:
    """The object without Gaussians that are not its own."""
    if job.config.hard:
        return Ground(studio, job, job.picked.to(studio.splats.means), parents, places)
    shares = soft_shares(studio.splats, job.picked, places)
    if (shares > 0).any():
        return Ground(studio, replace(job, picked=shares > 0), shares, parents, places)
    see_object(studio, job, studio.cameras)  # else that is why
    raise StyleSplatError(
        f"Cannot stylise {job.name}: most of what each of its Gaussians paints lies where they "
        "cover less than half. Pick more of the object, or paint it with Style(..., hard=True)."
    )
