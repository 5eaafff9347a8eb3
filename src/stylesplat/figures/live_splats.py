"""Splats as a browser shows them: in mean colours, some tinted or hidden, from its camera."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from stylesplat.figures.pictures import to_uint8
from stylesplat.rendering.one_view import render
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.sh import rgb_from_sh0, sh0_from_rgb
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.framing import centred_K
from stylesplat.scene.splats import Splats

PIXELS = 960 * 540  # of a picture at most: more takes longer than anybody waits
NAME = "browser"


def browser_camera(
    wxyz: Sequence[float] | Any,
    position: Sequence[float] | Any,
    fov: float,
    size: tuple[int, int],
    *,
    pixels: int = PIXELS,
) -> Cameras:
    """One camera that sees what a browser shows.

    Args:
        wxyz: The rotation from the camera (OpenCV axes) to the world.
        position: Where it is in the world.
        fov: Radians from the top to the bottom.
        size: Width and height of the browser's picture.
        pixels: How many ours has at most.
    """
    rotation = rotation_matrices(torch.as_tensor(wxyz).double()[None])[0]
    viewmat = torch.eye(4).double()
    viewmat[:3, :3] = rotation.T
    viewmat[:3, 3] = -rotation.T @ torch.as_tensor(position).double()
    width, height = (max(1, round(side)) for side in size)
    focal = height / (2 * math.tan(fov / 2))
    camera = Cameras(
        viewmats=viewmat[None].float(),
        Ks=centred_K(focal, (width, height))[None].float(),
        sizes=torch.tensor([[width, height]]),
        names=(NAME,),
    )
    return camera.downscale(max(1.0, math.sqrt(width * height / pixels)))


Color = tuple[float, float, float]

GLOW: Color = (1.0, 0.62, 0.05)  # what picked Gaussians are tinted with
POINTED: Color = (0.45, 0.75, 1.0)  # and those below the pointer
STRENGTH = 0.45  # of the tint: shapes and patterns are still seen


@dataclass(frozen=True)
class ViewerSplats:
    """What there is to see; the Gaussians themselves stay as they are."""

    splats: Splats
    """All of them."""
    glowing: Bool[Tensor, " N"] | None = None
    """Those that are tinted."""
    hidden: Bool[Tensor, " N"] | None = None
    """Those that are left out."""
    pointed: Bool[Tensor, " N"] | None = None
    """Those that are tinted otherwise."""

    @cached_property
    def visible(self) -> Splats:
        """Tinted, and without what is hidden."""
        splats = self.splats
        for rows, color in ((self.glowing, GLOW), (self.pointed, POINTED)):
            splats = splats if rows is None else glowed(splats, rows, color)
        return splats if self.hidden is None else splats[~self.hidden]

    @torch.no_grad()
    def render(self, camera: Cameras, background: Color) -> UInt8[Tensor, "H W 3"]:
        """The exact picture, with all bands of colour."""
        behind = torch.tensor(background).to(self.visible.means)
        image, _ = render(self.visible, camera, background=behind)
        return to_uint8(image).cpu()


def glowed(splats: Splats, picked: Bool[Tensor, " N"], color: Color = GLOW) -> Splats:
    """The splats with some Gaussians tinted."""
    share = STRENGTH * picked.to(splats.means)[:, None, None]
    tint = sh0_from_rgb(torch.tensor([color])).to(splats.sh0)
    return replace(
        splats,
        sh0=torch.lerp(splats.sh0, tint.expand_as(splats.sh0), share),
        shN=splats.shN * (1 - share),
    )


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

    def __init__(self, server: "viser.ViserServer", shown: ViewerSplats) -> None:
        """Show some for the first time."""
        self._of: Tensor | None = None
        self._all = torch.empty(0, 3, 3)
        self._node = server.scene.add_gaussian_splats(NODE, **self._arrays(shown))

    def show(self, shown: ViewerSplats) -> None:
        """Show others."""
        self._node.set_gaussians(**self._arrays(shown))

    def _arrays(self, shown: ViewerSplats) -> dict:
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

    def _shapes(self, shown: ViewerSplats) -> Float[Tensor, "N 3 3"]:
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
