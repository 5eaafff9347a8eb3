"""What a stylisation did: how close the object is to the style, and what else changed."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from stylesplat.metrics.psnr import decibels
from stylesplat.rendering.one_view import render
from stylesplat.rendering.shares import COVERED, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.matching import nnfm_loss
from stylesplat.stylization.views import ObjectView

RIM = 5  # pixels
MAX_FEATURES = 8192  # of an object in a view that are measured: block 1 has one per pixel


def view_loss(
    image: Float[Tensor, "H W 3"],
    view: ObjectView,
    targets: Sequence[Float[Tensor, "_ _"]],
    network: FeatureNetwork,
    blocks: Sequence[int],
) -> Float[Tensor, ""]:
    """NNFM over the object's own features in one view, averaged over the blocks.

    Of very many features some, evenly chosen, stand for all.
    """
    feats = network(image, blocks)
    losses = [
        nnfm_loss(block[cells][:: 1 + int(cells.sum()) // MAX_FEATURES], target)
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
) -> float:
    """The mean of `view_loss` over some views."""
    images = (render(splats, view.camera)[0] for view in views)
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
) -> dict[str, int | float]:
    """Compare renders before and after, where there is nothing of the picked Gaussians.

    Args:
        base: The scene before.
        styled: The scene after, which may have more Gaussians at its end.
        cameras: The views to compare in.
        picked: The Gaussians that were repainted.

    Returns:
        `changed_gaussians`, new ones included; `painted_gaussians` and `changed_outside`, those of
        the picked and of all others that differ; `outside_psnr` (120 at most) and
        `outside_max_difference` over pixels that none of them touches; `edge_psnr` over those that
        they cover in part, but by less than half; `rim_error`, the mean absolute difference in a
        band of 5 pixels around what they cover by half or more.
    """
    outside, edge, rim = [], [], []
    for index in range(len(cameras)):
        camera = cameras[index]
        before, after = (render(s, camera)[0] for s in (base, styled))
        difference = after.clamp(0, 1) - before.clamp(0, 1)
        covered = coverage(base, camera, picked)
        outside.append(difference[covered == 0].flatten())
        edge.append(difference[(covered > 0) & (covered < COVERED)].flatten())
        rim.append(difference[_rim(covered >= COVERED)].flatten())
    changed = _changed(base, styled)
    largest = max((float(d.abs().max()) for d in outside if len(d)), default=0.0)
    errors = torch.cat(rim).abs()
    return {
        "changed_gaussians": int(changed.sum()) + len(styled) - len(base),
        "painted_gaussians": int((changed & picked).sum()),
        "changed_outside": int((changed & ~picked).sum()),
        "outside_psnr": _psnr(torch.cat(outside)),
        "outside_max_difference": largest,
        "edge_psnr": _psnr(torch.cat(edge)),
        "rim_error": float(errors.sum()) / max(1, len(errors)),
    }


def _changed(base: Splats, styled: Splats) -> Bool[Tensor, " N"]:
    """Which Gaussians differ in any number."""
    pairs = [
        (old.view(len(old), -1), styled.tensors()[name][: len(old)].reshape(len(old), -1))
        for name, old in base.tensors().items()
        if old.numel()
    ]
    differs = [(old != new).any(dim=1) for old, new in pairs]
    return torch.stack(differs).any(dim=0)


def _rim(covered: Bool[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    """The pixels at most `RIM` pixels outside a mask."""
    grown = F.max_pool2d(covered[None].float(), 2 * RIM + 1, stride=1, padding=RIM)[0] > 0
    return grown & ~covered


def _psnr(difference: Float[Tensor, " P"]) -> float:
    """Of no pixels at all it is that of equal ones."""
    return float(decibels(difference.square().sum() / max(1, len(difference))))
