"""The splats in a browser: in their mean colours, replaced as they change."""

from typing import TYPE_CHECKING

import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.figures.shown import Shown
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.sh import rgb_from_sh0
from stylesplat.scene.splats import Splats

if TYPE_CHECKING:
    import viser

MOST = 500_000  # Gaussians that a browser is sent; a laptop turns 300,000 smoothly
PARENT = "/seen"  # each browser has one of its own, by which it hides them
NODE = f"{PARENT}/splats"


def covariances(splats: Splats) -> Float[Tensor, "N 3 3"]:
    """World covariance of each Gaussian."""
    axes = rotation_matrices(splats.quats) * splats.scales.exp()[:, None]
    return axes @ axes.mT


class LiveSplats:
    """The Gaussians as all browsers of a server show them."""

    def __init__(self, server: "viser.ViserServer", shown: Shown) -> None:
        """Show some for the first time."""
        self._of: Tensor | None = None
        self._all = torch.empty(0, 3, 3)
        self._node = server.scene.add_gaussian_splats(NODE, **self._arrays(shown))

    def show(self, shown: Shown) -> None:
        """Show others."""
        self._node.set_gaussians(**self._arrays(shown))

    def _arrays(self, shown: Shown) -> dict:
        splats, shapes = shown.visible.detach(), self._shapes(shown)
        rows = weightiest(splats, MOST)
        if rows is not None:
            splats, shapes = splats[rows], shapes[rows]
        return {
            "centers": splats.means.cpu().numpy(),
            "covariances": shapes.cpu().numpy(),
            "rgbs": rgb_from_sh0(splats.sh0[:, 0]).clamp(0, 1).cpu().numpy(),
            "opacities": torch.sigmoid(splats.opacities)[:, None].cpu().numpy(),
        }

    def _shapes(self, shown: Shown) -> Float[Tensor, "N 3 3"]:
        """Covariances of what is visible; computed once for as long as shapes stay."""
        if self._of is not shown.splats.scales:
            self._all, self._of = covariances(shown.splats.detach()), shown.splats.scales
        return self._all if shown.hidden is None else self._all[~shown.hidden]


def weightiest(splats: Splats, count: int) -> Int[Tensor, " M"] | None:
    """The Gaussians that show most, in their order; None if there are no more than so many."""
    if len(splats) <= count:
        return None
    sizes = splats.scales.sort(dim=1).values[:, 1:].sum(dim=1)  # logarithm of the larger area
    weights = torch.nn.functional.logsigmoid(splats.opacities) + sizes
    return weights.topk(count).indices.sort().values
