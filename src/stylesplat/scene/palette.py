"""Colours of a palette exchanged for others, each along its own tone curve.

As in ColorGradedGaussians (arXiv 2604.01551) a palette entry stands for all its shades. Here they
lie on a curve from black through the entry to white, and an exchange takes each luma to the place
on the other's curve: shadows stay dark, highlights stay light and lose their colour as they did.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.scene.splats import LUMA, rgb_from_sh0, sh0_from_rgb

PALETTE_LUMA = (0.04, 0.96)  # of an entry: its curve has two ends
PALETTE_BLUR = 0.06  # of colours in 0..1: nearer to two entries than this a colour is of both
OF_LUMA = 0.3  # how much a difference of luma counts beside one of colour: shades differ in luma
PALETTE_GREY = 0.02  # colourfulness below which an entry has no direction of its own


def tone_curves(
    rgb: Float[Tensor, "N 3"], entries: Float[Tensor, "K 3"]
) -> tuple[Float[Tensor, "N K"], Float[Tensor, "N K"]]:
    """How much of its tint each entry has at the luma of each colour, and the squared distances."""
    luma = rgb.new_tensor(LUMA)
    lumas, y = (entries @ luma).clamp(*PALETTE_LUMA), (rgb @ luma)[:, None]
    tints = entries - (entries @ luma)[:, None]
    share = torch.where(y < lumas, y / lumas, (1 - y) / (1 - lumas)).clamp(min=0)  # [N, K]
    away = (rgb - y)[:, None] - share[..., None] * tints
    return share, away.square().sum(dim=2) + (OF_LUMA * (y - lumas)).square()


def map_palette(
    sh0: Float[Tensor, "N 1 3"], shN: Float[Tensor, "N _ 3"], palette: Float[Tensor, "K 6"]
) -> tuple[Float[Tensor, "N 1 3"], Float[Tensor, "N _ 3"]]:
    """The bands that show other colours: of each row what the first three numbers become.

    The constant band decides which entries a Gaussian belongs to. Its higher bands are mapped by
    the slope there, so that what changes with the view changes likewise.
    """
    luma = sh0.new_tensor(LUMA)
    rgb = rgb_from_sh0(sh0[:, 0])
    before, after = palette.to(rgb).split(3, dim=1)
    lumas = [(each @ luma).clamp(*PALETTE_LUMA) for each in (before, after)]
    tints = [each - (each @ luma)[:, None] for each in (before, after)]
    y = rgb @ luma
    tint = rgb - y[:, None]
    lower = y[:, None] < lumas[0]  # [N, K]
    share, distances = tone_curves(rgb, before)
    weights = torch.softmax(-distances / (2 * PALETTE_BLUR**2), dim=1)  # [N, K]
    steep = torch.where(lower, lumas[1] / lumas[0], (1 - lumas[1]) / (1 - lumas[0]))
    start = torch.where(lower, 0.0, 1 - steep)
    norm = tints[0].square().sum(dim=1) + PALETTE_GREY**2
    along = (tint @ tints[0].T + PALETTE_GREY**2 * share) / norm
    change = tints[1] - tints[0]
    moved = tint + ((weights * along) @ change)
    light = (weights * (start + steep * y[:, None])).sum(dim=1)
    lit = (weights * steep).sum(dim=1)[:, None, None]
    higher = (shN @ luma)[..., None]
    colored = shN - higher
    turned = colored @ (tints[0] / norm[:, None]).T * weights[:, None]  # [N, bands, K]
    return (
        sh0_from_rgb(light[:, None] + moved)[:, None],
        lit * higher + colored + turned @ change,
    )
