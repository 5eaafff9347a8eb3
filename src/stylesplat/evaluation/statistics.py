"""What NNFM does not measure: colours, and the object's own content."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.metrics.images import ssim_map
from stylesplat.metrics.lab import LUMA, cells, distinct, lab_from_rgb, nearest_colors, thinned
from stylesplat.rendering.render import render
from stylesplat.rendering.shares import COVERED, colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

TOLERANCE = 10.0  # of Lab, from which a colour is another one, rather than another shade
SAME = 1.0  # of Lab, the size of the cubes whose colours count as one
SURELY_NEAR = 5.0  # of Lab: no colours in a cube of this size are farther apart than 8.7


@torch.no_grad()
def content_ssim(
    base: Splats,
    styled: Splats,
    cameras: Cameras,
    picked: Bool[Tensor, " N"],
) -> float | None:
    """SSIM of an object's luminance before and after: how much of its content is left.

    Returns:
        1 if nothing changed. The mean over the object's pixels, then over the views that show
        it; None if none does.
    """
    scores = []
    for index in range(len(cameras)):
        before, coverage = colors_and_coverage(base, cameras[index], picked)
        covered = coverage[..., 0] > COVERED
        if covered.any():
            after = render(styled, cameras[index])[0]
            luminances = [(i.clamp(0, 1) @ i.new_tensor(LUMA))[None] for i in (before, after)]
            scores.append(ssim_map(*luminances)[0][covered].mean())
    return float(torch.stack(scores).mean()) if scores else None


def off_palette(colors: Float[Tensor, "P 3"], style: Float[Tensor, "Q 3"]) -> float:
    """The share of colours that are farther than 10 in Lab (CIE 1976) from all of the style.

    All are in 0..1. A large set is sampled evenly; colours of the style that differ by less than
    about 1 count as one.
    """
    lab = lab_from_rgb(thinned(colors))
    palette = lab_from_rgb(distinct(style, SAME))
    far = ~torch.isin(cells(lab, SURELY_NEAR), cells(palette, SURELY_NEAR))
    if not far.any():
        return 0.0
    others = lab[far]
    distances = (others - palette[nearest_colors(others, palette)]).norm(dim=1)
    return int((distances > TOLERANCE).sum()) / len(lab)
