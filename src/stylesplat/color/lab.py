"""CIE Lab, in which equal distances look about equally large."""

from functools import lru_cache

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from stylesplat.scene.sampling import evenly

TO_XYZ = ((0.4124564, 0.3575761, 0.1804375), (0.2126729, 0.7151522, 0.0721750))
TO_XYZ += ((0.0193339, 0.1191920, 0.9503041),)  # sRGB, IEC 61966-2-1
LUMA = (0.2126, 0.7152, 0.0722)  # Rec. 709: how bright red, green and blue are
D65 = (0.95047, 1.0, 1.08883)
LOWEST, RANGE = -128.0, 256.0  # L, a and b of all sRGB colours lie well within
PIXELS = 2**14  # of a picture that stand for all
DISTANCES_AT_ONCE = 2**22  # bounds the colours x colours matrix


def linear_rgb(colors: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 3"]:
    """Intensities of light, 0 to 1, of sRGB colours (IEC 61966-2-1)."""
    return torch.where(colors > 0.04045, ((colors + 0.055) / 1.055) ** 2.4, colors / 12.92)


def lab_from_rgb(colors: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 3"]:
    """sRGB colours, clamped to 0..1, as L in 0..100, a and b (CIE 1976, white D65)."""
    xyz = linear_rgb(colors.clamp(0, 1)) @ colors.new_tensor(TO_XYZ).T / colors.new_tensor(D65)
    cubes = torch.where(xyz > (6 / 29) ** 3, xyz ** (1 / 3), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = cubes.unbind(-1)
    return torch.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], dim=-1)


@lru_cache(maxsize=8)
@torch.inference_mode(False)  # else training could not use them later
def luma_weights(device: torch.device, dtype: torch.dtype) -> Float[Tensor, " 3"]:
    """`LUMA` on a device, to which it is copied once: every copy makes the host wait."""
    return torch.tensor(LUMA, device=device, dtype=dtype)


def thinned(colors: Float[Tensor, "P 3"]) -> Float[Tensor, "_ 3"]:
    """Evenly chosen ones of very many colours."""
    return colors[evenly(range(len(colors)), PIXELS)]


def cells(lab: Float[Tensor, "P 3"], size: float) -> Int[Tensor, " P"]:
    """The number of the cube of this size that each colour lies in."""
    x, y, z = ((lab - LOWEST) / size).long().unbind(-1)
    side = int(RANGE / size) + 1
    return (x * side + y) * side + z


def distinct(colors: Float[Tensor, "P 3"], size: float) -> Float[Tensor, "_ 3"]:
    """The mean of the colours, in 0..1, of each cube of Lab of this size that holds any."""
    places = cells(lab_from_rgb(colors), size)
    _, owners, counts = places.unique(return_inverse=True, return_counts=True)
    return colors.new_zeros(len(counts), 3).index_add_(0, owners, colors) / counts[:, None]


@torch.no_grad()
def nearest_colors(lab: Float[Tensor, "P 3"], palette: Float[Tensor, "Q 3"]) -> Int[Tensor, " P"]:
    """The row of the nearest colour of a palette for each colour, both in Lab (CIE 1976)."""
    columns = torch.cat([-2 * palette.T, palette.square().sum(dim=1)[None]])
    rows = F.pad(lab, (0, 1), value=1.0)
    chunks = rows.split(max(1, DISTANCES_AT_ONCE // len(palette)))
    return torch.cat([(chunk @ columns).argmin(dim=1) for chunk in chunks])
