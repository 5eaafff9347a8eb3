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
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.render import render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.framing import centred_K
from stylesplat.scene.splats import Splats, rgb_from_sh0, sh0_from_rgb

if TYPE_CHECKING:
    import viser

PIXELS = 960 * 540  # of an exact picture at most: more takes too long
NAME = "browser"
Color = tuple[float, float, float]
GLOW: Color = (1.0, 0.62, 0.05)  # tint of selected Gaussians
POINTED: Color = (0.45, 0.75, 1.0)  # tint of those below the pointer
STRENGTH = 0.45  # of the tint: shapes and patterns stay visible
MOST = 500_000  # Gaussians that are sent to a browser; a laptop turns 300,000 smoothly
PARENT = "/seen"  # a node of each browser, by which the splats are hidden there
NODE = f"{PARENT}/splats"


def browser_camera(
    wxyz: Sequence[float] | Any,
    position: Sequence[float] | Any,
    fov: float,
    size: tuple[int, int],
    *,
    pixels: int = PIXELS,
) -> Cameras:
    """Returns the camera of a browser."""
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


@dataclass(frozen=True)
class ViewerSplats:
    """Splats for a viewer, in which some Gaussians are tinted or hidden."""

    splats: Splats
    """All Gaussians, as they are."""
    glowing: Bool[Tensor, " N"] | None = None
    """Gaussians with the tint of a selection."""
    hidden: Bool[Tensor, " N"] | None = None
    """Gaussians that are not drawn."""
    pointed: Bool[Tensor, " N"] | None = None
    """Gaussians below the pointer."""

    @cached_property
    def visible(self) -> Splats:
        """The drawn Gaussians with their tints."""
        splats = self.splats
        for rows, color in ((self.glowing, GLOW), (self.pointed, POINTED)):
            splats = splats if rows is None else glowed(splats, rows, color)
        return splats if self.hidden is None else splats[~self.hidden]

    @torch.no_grad()
    def render(self, camera: Cameras, background: Color) -> UInt8[Tensor, "H W 3"]:
        """Render the exact picture, with view-dependent colours."""
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


def covariances(splats: Splats) -> Float[Tensor, "N 3 3"]:
    """World covariance of each Gaussian."""
    axes = rotation_matrices(splats.quats) * splats.scales.exp()[:, None]
    return axes @ axes.mT


class LiveSplats:
    """The Gaussians in all browsers of a server, in their mean colours."""

    def __init__(self, server: "viser.ViserServer", shown: ViewerSplats) -> None:
        """Send the first Gaussians."""
        self._of: Tensor | None = None
        self._all = torch.empty(0, 3, 3)
        self._node = server.scene.add_gaussian_splats(NODE, **self._arrays(shown))

    def show(self, shown: ViewerSplats) -> None:
        """Replace the Gaussians."""
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
        """Covariances of the drawn Gaussians, computed again only when shapes change."""
        if self._of is not shown.splats.scales:
            self._all, self._of = covariances(shown.splats.detach()), shown.splats.scales
        return self._all if shown.hidden is None else self._all[~shown.hidden]


def weightiest(splats: Splats, count: int) -> Int[Tensor, " M"] | None:
    """Rows of the `count` Gaussians of the largest visible area; None if there are not more."""
    if len(splats) <= count:
        return None
    sizes = splats.scales.sort(dim=1).values[:, 1:].sum(dim=1)  # logarithm of the larger area
    weights = torch.nn.functional.logsigmoid(splats.opacities) + sizes
    return weights.topk(count).indices.sort().values
