"""What the readers of COLMAP and transforms.json have in common."""

from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.io.captures.lens import Lens


@dataclass(frozen=True)
class PosedFiles:
    """Posed photos as a capture's files describe them; no photo has been looked at."""

    names: tuple[str, ...]
    """Of the photos, within their common folder."""
    paths: tuple[Path, ...]
    """Of the photos."""
    lenses: tuple[Lens, ...]
    """What they were taken with."""
    viewmats: Float[Tensor, "C 4 4"]
    """World to camera, OpenCV axes, as read: not checked, 64 bits."""
    points: Float[Tensor, "M 3"] | None
    """Sparse points in the world."""
    point_colors: UInt8[Tensor, "M 3"] | None
    """Colours of `points`."""
