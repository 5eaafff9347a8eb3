"""Fitting the discs of a canvas, so that the object looks as it did before it was laid.

Renders of the scene before tell what opacities, scales and colours have to be; no photos are
needed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.progress import track
from stylesplat.rendering import cpu
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.gaussians import activated, views_of, with_matrices_of
from stylesplat.rendering.render import rasterize, render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import drawn, evenly
from stylesplat.scene.splats import SH_C0, Splats, sh0_from_rgb
from stylesplat.stylization.canvas import Canvas
from stylesplat.stylization.views import Box, crop_to_box, typical_length
from stylesplat.training.adam import Moments, adam_step

VIEWS = 16
LENGTH = 180  # longer side of the object in them, in pixels
MARGIN = 8  # pixels around a box, where nothing is to show
STEPS = 35
RATES = {"opacities": 0.1, "scales": 0.03, "sh0": 0.05}  # of logits, logarithms and colours
RAISED = 0.4  # colours at most: more is noise, with none what lies behind shines through
LAST = 0.1  # rate of the last step, as a share of the first's


@dataclass(frozen=True)
class _View:
    """What one camera saw before the canvas was laid, and what it sees of it."""

    camera: Cameras
    image: Float[Tensor, "H W 3"]
    coverage: Float[Tensor, "H W 1"]
    shown: Bool[Tensor, " N"]
    """Which Gaussians of the scene with the canvas are drawn."""
    splats: Splats
    """These, in the colours that they have from there."""
    mask: Float[Tensor, "M 1 1"]
    """1 for those of the object, 0 for others."""

    def error(
        self, leaves: Mapping[str, Tensor], fitted: Bool[Tensor, " N"], raised: Float[Tensor, " 3"]
    ) -> Float[Tensor, ""]:
        """Of the image of other Gaussians, the object's colours being raised.

        By other amounts in every step, so that its coverage has to be right whatever lies behind.
        """
        moved = {"sh0": self.splats.sh0} | {k: leaf[self.shown] for k, leaf in leaves.items()}
        sh0 = torch.where(fitted[self.shown, None, None], moved["sh0"], self.splats.sh0)
        moved["sh0"] = sh0 + raised / SH_C0 * self.mask
        image, _, _ = rasterize(replace(self.splats, **moved), self.camera)
        return (image[0] - self.image - raised * self.coverage).square().mean()


def fit_canvas(
    splats: Splats,
    canvas: Canvas,
    mask: Bool[Tensor, " N"],
    boxes: Sequence[Box],
    *,
    seed: int,
) -> Canvas:
    """Give the discs of a canvas what makes the object look as before.

    Args:
        splats: The scene before, on the CPU.
        canvas: What was laid on it.
        mask: The object's Gaussians.
        boxes: Where the object lies in the views to compare.
        seed: Of the order of the views, and of the colours that tell object and background apart.
    """
    zoom = min(1.0, LENGTH / typical_length(boxes))
    cuts = [crop_to_box(box, zoom, (MARGIN, MARGIN))[0] for box in evenly(boxes, VIEWS)]
    views = [*at_once(partial(_look, splats, canvas, mask), cuts)]
    leaves = {name: canvas.splats.tensors()[name].clone().requires_grad_() for name in RATES}
    moments = Moments.zeros(leaves)
    generator = torch.Generator().manual_seed(seed)
    shown = track(drawn(views, STEPS, generator), "fitting the canvas", total=STEPS)
    for step, view in enumerate(shown, start=1):
        raised = RAISED * torch.rand(3, generator=generator)
        with torch.enable_grad():
            view.error(leaves, canvas.is_disc, raised.to(view.image)).backward()
        now = {name: rate * LAST ** (step / STEPS) for name, rate in RATES.items()}
        adam_step(leaves, moments, now, step, visible=canvas.is_disc & view.shown)
        for leaf in leaves.values():
            leaf.grad = None
    found = {name: leaf.detach() for name, leaf in leaves.items()}
    return replace(canvas, splats=replace(canvas.splats, **found))


@torch.no_grad()
def _look(splats: Splats, canvas: Canvas, mask: Tensor, camera: Cameras) -> _View:
    """What a camera saw, and the Gaussians that it draws now."""
    features = mask.to(splats.means)[:, None]
    image, _ = render(splats, camera, features=features)
    image, coverage = image.split((3, 1), dim=2)
    views = views_of(with_matrices_of(canvas.splats, camera))
    shown = (cpu.project_gaussians(activated(canvas.splats), views[0]).radii > 0).all(dim=1)
    seen = replace(canvas.splats, identities=None, confidence=None)[shown]
    directions = seen.means - camera.positions.to(seen.means)
    colors = cpu.spherical_harmonics(seen.sh_degree, directions, seen.sh0, seen.shN)
    baked = replace(seen, sh0=sh0_from_rgb(colors)[:, None], shN=seen.shN[:, :0])
    mine = mask[canvas.parents[shown], None, None].to(image)
    return _View(camera, image, coverage, shown, baked, mine)
