"""What an object is painted on: Gaussians that are its own, by shares, and fine enough."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import say
from stylesplat.scene.compose import UNSEEN
from stylesplat.scene.splats import Splats
from stylesplat.selection.contacts import on_support
from stylesplat.selection.soft_picks import Place, find_places, seen_anew, soft_shares
from stylesplat.stylization.fresh_canvas import fresh_canvas
from stylesplat.stylization.looking import see_object
from stylesplat.stylization.object_views import Box
from stylesplat.stylization.split import Split
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
    bare: Splats | None = None
    """The same Gaussians without the fresh canvas, which does not show; None if there is none."""

    @property
    def unpainted(self) -> Splats:
        """The same Gaussians as the scene looked before."""
        return self.studio.splats if self.bare is None else self.bare

    def handed_down(self, earlier: Splats) -> Splats:
        """The object's Gaussians in the colours that their parents had earlier."""
        rows = self.job.picked.nonzero()[:, 0]
        parents = self.parents[rows]
        colors = {"sh0": earlier.sh0[parents], "shN": earlier.shN[parents]}
        return self.studio.splats.with_rows(rows, colors)


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


def finer_ground(ground: Ground, boxes: Sequence[Box], length: float) -> Ground:
    """The same with Gaussians that are fine enough: a fresh canvas, or split ones.

    Args:
        ground: Not split yet.
        boxes: Where the object is seen.
        length: Its longer side in pixels, for which Gaussians are to be fine enough.

    Raises:
        StyleSplatError: If it is hardly visible.
    """
    count = int(ground.job.picked.sum())
    growth = ground.job.config.growth(count)
    room = int((growth - 1) * count)
    config = ground.job.config
    if room == 0 or config.intensity == 0 or config.canvas == "own":
        return ground
    # contributions are known on the CPU only
    studio = replace(ground.studio, splats=ground.studio.splats.to("cpu"))
    job, device = replace(ground.job, picked=ground.job.picked.cpu()), ground.studio.splats.device
    split = _canvas(studio, job, boxes, length, room)
    if split is None:
        return ground
    split = Split(split.splats.to(device), split.parents.to(device))
    job = replace(ground.job, picked=ground.job.picked[split.parents])
    studio = replace(ground.studio, splats=split.splats)
    places = seen_anew(studio.splats, job.picked, ground.places)
    finer = _with_shares(studio, job, split.parents, places)
    return replace(finer, bare=_bare(ground.studio.splats, finer))


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
        "cover less than half. Pick more of the object, or pass --hard (hard=True)."
    )


def _canvas(
    studio: Studio, job: StyleJob, boxes: Sequence[Box], length: float, room: int
) -> Split | None:
    """The scene with a fresh canvas on the object, if that is possible."""
    split = fresh_canvas(
        studio.splats,
        job.picked,
        boxes,
        studio.every_camera,
        length=length,
        room=room,
        seed=job.config.seed,
    )
    if split is None:
        say(f"{job.name} has no surface for a fresh canvas: its own Gaussians are painted.")
    return split


def _bare(splats: Splats, ground: Ground) -> Splats:
    """What lies on a canvas without it."""
    laid = ground.studio.splats
    unseen = laid.opacities[len(splats) :] * 0 + UNSEEN
    return replace(laid, opacities=torch.cat([splats.opacities, unseen]))
