"""What of a scene a browser shows: some Gaussians glow, some are hidden."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from stylesplat.figures.compositing import to_uint8
from stylesplat.rendering.render import render
from stylesplat.rendering.sh import sh0_from_rgb
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

Color = tuple[float, float, float]

GLOW: Color = (1.0, 0.62, 0.05)  # what picked Gaussians are tinted with
POINTED: Color = (0.45, 0.75, 1.0)  # and those below the pointer
STRENGTH = 0.45  # of the tint: shapes and patterns are still seen


@dataclass(frozen=True)
class Shown:
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
