"""What a stylisation did: how close the object is to the style, and what else changed."""

from collections.abc import Sequence
from typing import TypeVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from stylesplat.rendering.rasterize import Backend, rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.nnfm import nnfm_loss
from stylesplat.stylization.views import COVERED, ObjectView, coverage

SMALLEST_ERROR = 1e-12  # a mean square below float32's rounding counts as this: 120 dB

T = TypeVar("T")


def evenly(items: Sequence[T], count: int) -> list[T]:
    """At most `count` of the items, at equal distances."""
    count = min(count, len(items))
    return [items[(2 * i + 1) * len(items) // (2 * count)] for i in range(count)]


def view_loss(
    image: Float[Tensor, "H W 3"],
    view: ObjectView,
    targets: Sequence[Float[Tensor, "_ _"]],
    network: FeatureNetwork,
    blocks: Sequence[int],
) -> Float[Tensor, ""]:
    """NNFM over the object's own features in one view, averaged over the blocks."""
    feats = network(image, blocks)
    losses = [
        nnfm_loss(block[cells], target)
        for block, cells, target in zip(feats, view.cells, targets, strict=True)
    ]
    return torch.stack(losses).mean()


@torch.no_grad()
def object_nnfm(
    splats: Splats,
    views: Sequence[ObjectView],
    targets: Sequence[Float[Tensor, "_ _"]],
    network: FeatureNetwork,
    blocks: Sequence[int],
    *,
    backend: Backend = "auto",
) -> float:
    """The mean of `view_loss` over some views."""
    images = (rasterize(splats, view.camera, backend=backend)[0][0] for view in views)
    losses = [
        view_loss(image.clamp(0, 1), view, targets, network, blocks)
        for image, view in zip(images, views, strict=True)
    ]
    return float(torch.stack(losses).mean())


@torch.no_grad()
def changes(
    base: Splats,
    styled: Splats,
    cameras: Cameras,
    picked: Bool[Tensor, " N"],
    *,
    backend: Backend = "auto",
) -> dict[str, int | float]:
    """Compare renders before and after, where there is nothing of the picked Gaussians.

    Args:
        base: The scene before.
        styled: The scene after.
        cameras: The views to compare in.
        picked: The Gaussians that were repainted.
        backend: Of the rasteriser.

    Returns:
        `changed_gaussians`; `outside_psnr` (120 at most) and `outside_max_difference` over
        pixels that none of them touches; `edge_psnr` over those that they cover in part, but
        by less than half.
    """
    outside, edge = [], []
    for index in range(len(cameras)):
        camera = cameras[index]
        before, after = (rasterize(s, camera, backend=backend)[0][0] for s in (base, styled))
        difference = after.clamp(0, 1) - before.clamp(0, 1)
        covered = coverage(base, camera, picked, backend=backend)
        outside.append(difference[covered == 0].flatten())
        edge.append(difference[(covered > 0) & (covered < COVERED)].flatten())
    changed = (base.sh0 != styled.sh0).any(dim=(1, 2)) | (base.shN != styled.shN).any(dim=(1, 2))
    largest = max((float(d.abs().max()) for d in outside if len(d)), default=0.0)
    return {
        "changed_gaussians": int(changed.sum()),
        "outside_psnr": _psnr(torch.cat(outside)),
        "outside_max_difference": largest,
        "edge_psnr": _psnr(torch.cat(edge)),
    }


def _psnr(difference: Float[Tensor, " P"]) -> float:
    error = difference.square().sum() / max(1, len(difference))
    return float(-10 * error.clamp(min=SMALLEST_ERROR).log10())
