"""How much a picture changed inside or outside a mask: leakage and strength of an edit."""

from jaxtyping import Float
from torch import Tensor

from stylesplat.evaluation.changes import CHANGED
from stylesplat.imaging.color import lab_from_rgb
from stylesplat.imaging.similarity import decibels
from stylesplat.scene.capture import Mask


def changed_share(
    before: Float[Tensor, "H W 3"], after: Float[Tensor, "H W 3"], mask: Mask
) -> float:
    """The share of a mask's pixels that changed by more than 0.05 in a channel; 0 without any."""
    gaps = (after - before)[mask].abs().amax(dim=-1)
    return float((gaps > CHANGED).float().mean()) if len(gaps) else 0.0


def masked_psnr(before: Float[Tensor, "H W 3"], after: Float[Tensor, "H W 3"], mask: Mask) -> float:
    """PSNR in decibels over a mask's pixels, 120 at most and for an empty mask."""
    squares = (after - before)[mask].square()
    return float(decibels(squares.sum() / max(1, squares.numel())))


def strength(before: Float[Tensor, "H W 3"], after: Float[Tensor, "H W 3"], mask: Mask) -> float:
    """The mean distance in Lab (CIE 1976) over a mask: 2.3 is just visible, 100 black to white."""
    if not mask.any():
        return 0.0
    gaps = lab_from_rgb(after[mask]) - lab_from_rgb(before[mask])
    return float(gaps.norm(dim=-1).mean())
