"""Fitting the children of split Gaussians, so that the object looks as it did before.

A grid of children is nearly its parent's shape, but children hide each other, lie at several
depths and fall below the faintest opacity that is drawn. Renders of the scene before the split
tell what their opacities and scales have to be; no photos are needed.
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
from stylesplat.rendering.gaussians import views_of
from stylesplat.rendering.one_view import render
from stylesplat.rendering.rasterize import activated, beside, rasterize
from stylesplat.rendering.sh import SH_C0, sh0_from_rgb
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.sampling import drawn, evenly
from stylesplat.scene.splats import Splats
from stylesplat.stylization.object_views import Box, around, typical_length
from stylesplat.stylization.split import Split
from stylesplat.training.adam import Moments, adam_step

VIEWS = 16
LENGTH = 180  # longer side of the object in them, in pixels
MARGIN = 8  # pixels around a box, where nothing is to show
STEPS = 40  # twice as many at 240 pixels cost three times as much, and spare 0.1 dB
RATES = {"opacities": 0.1, "scales": 0.03}  # of logits and logarithms; the others do not help
RAISED = 0.4  # colours at most: more is noise, with none what lies behind shines through
LAST = 0.1  # rate of the last step, as a share of the first's


@dataclass(frozen=True)
class _View:
    """What one camera saw before the split, and what it sees of the children."""

    camera: Cameras
    image: Float[Tensor, "H W 3"]
    coverage: Float[Tensor, "H W 1"]
    shown: Bool[Tensor, " N"]
    """Which Gaussians of the split scene are drawn."""
    splats: Splats
    """These, in the colours that they have from there."""
    picked: Float[Tensor, "M 1 1"]
    """1 for those of the object, 0 for others."""

    def error(
        self, leaves: Mapping[str, Tensor], fitted: Bool[Tensor, " N"], raised: Float[Tensor, " 3"]
    ) -> Float[Tensor, ""]:
        """Of the image of other Gaussians, the object's colours being raised.

        By other amounts in every step, so that its coverage has to be right whatever lies behind.
        """
        moved = {"sh0": self.splats.sh0} | {k: leaf[self.shown] for k, leaf in leaves.items()}
        sh0 = torch.where(fitted[self.shown, None, None], moved["sh0"], self.splats.sh0)
        moved["sh0"] = sh0 + raised / SH_C0 * self.picked
        image, _, _ = rasterize(replace(self.splats, **moved), self.camera)
        return (image[0] - self.image - raised * self.coverage).square().mean()


def refit(
    splats: Splats,
    split: Split,
    picked: Bool[Tensor, " N"],
    boxes: Sequence[Box],
    *,
    seed: int = 0,
) -> Split:
    """Give split Gaussians the opacities and scales with which the object looks as before.

    Means, rotations and colours stay, and so does every Gaussian that was not split.

    Args:
        splats: The scene before the split, on the CPU.
        split: After it.
        picked: The object's Gaussians, before.
        boxes: Where the object lies in the views to compare.
        seed: Of the order of the views, and of the colours that tell object and background apart.
    """
    divided = split.parents.bincount(minlength=len(splats))[split.parents] > 1
    if not divided.any():
        return split
    return fit(splats, split, picked, boxes, divided, RATES, steps=STEPS, seed=seed)


def fit(
    splats: Splats,
    split: Split,
    picked: Bool[Tensor, " N"],
    boxes: Sequence[Box],
    fitted: Bool[Tensor, " M"],
    rates: Mapping[str, float],
    *,
    steps: int,
    seed: int,
) -> Split:
    """Give some Gaussians of a split scene what makes the object look as before.

    Args:
        splats: The scene before the split, on the CPU.
        split: After it.
        picked: The object's Gaussians, before.
        boxes: Where the object lies in the views to compare.
        fitted: Which Gaussians, after. Colours are fitted of those only that have no higher bands.
        rates: What of them changes, and how fast.
        steps: How many.
        seed: Of the order of the views, and of the colours that tell object and background apart.
    """
    zoom = min(1.0, LENGTH / typical_length(boxes))
    cuts = [around(box, zoom, (MARGIN, MARGIN))[0] for box in evenly(boxes, VIEWS)]
    views = [*at_once(partial(_look, splats, split, picked), cuts)]
    leaves = {name: split.splats.tensors()[name].clone().requires_grad_() for name in rates}
    moments = Moments.zeros(leaves)
    generator = torch.Generator().manual_seed(seed)
    shown = track(drawn(views, steps, generator), "fitting new Gaussians", total=steps)
    for step, view in enumerate(shown, start=1):
        raised = RAISED * torch.rand(3, generator=generator)
        with torch.enable_grad():
            view.error(leaves, fitted, raised.to(view.image)).backward()
        now = {name: rate * LAST ** (step / steps) for name, rate in rates.items()}
        adam_step(leaves, moments, now, step, seen=fitted & view.shown)
        for leaf in leaves.values():
            leaf.grad = None
    found = {name: leaf.detach() for name, leaf in leaves.items()}
    return replace(split, splats=replace(split.splats, **found))


@torch.no_grad()
def _look(splats: Splats, split: Split, picked: Tensor, camera: Cameras) -> _View:
    """What a camera saw, and the Gaussians that it draws now."""
    features = picked.to(splats.means)[:, None]
    image, _ = render(splats, camera, features=features)
    image, coverage = image.split((3, 1), dim=2)
    views = views_of(beside(split.splats, camera))
    shown = (cpu.project_gaussians(activated(split.splats), views[0]).radii > 0).all(dim=1)
    seen = replace(split.splats, identities=None, confidence=None)[shown]
    directions = seen.means - camera.positions.to(seen.means)
    colors = cpu.spherical_harmonics(seen.sh_degree, directions, seen.sh0, seen.shN)
    baked = replace(seen, sh0=sh0_from_rgb(colors)[:, None], shN=seen.shN[:, :0])
    mine = picked[split.parents[shown], None, None].to(image)
    return _View(camera, image, coverage, shown, baked, mine)
