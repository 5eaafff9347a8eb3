"""The `Capture` noun: posed photos, with label maps if there are any."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import OwnLabels


@dataclass(frozen=True)
class Capture:
    """Posed photos. Photos and label maps are sequences that may load on access."""

    cameras: Cameras
    """One per photo, of the photo's size."""
    photos: Sequence[UInt8[Tensor, "_ _ 3"]]
    """Undistorted photos, sRGB."""
    label_maps: Sequence[OwnLabels | None] | None = None
    """Per photo the label id of each pixel, 0 = background; None where a photo has none."""
    points: Float[Tensor, "M 3"] | None = None
    """Sparse points in the world, to start training from."""
    point_colors: UInt8[Tensor, "M 3"] | None = None
    """Colours of `points`."""
    path: Path | None = None
    """The folder that this was read from."""
    object_names: Mapping[int, str] = field(default_factory=dict)
    """What objects are called, by label id; most have no name."""
    full: Cameras | None = None
    """The cameras at the photos' full size, if the photos are smaller here."""
    downscale: float = 1.0
    """How many times smaller they are."""

    def __post_init__(self) -> None:
        for what, items in (("photos", self.photos), ("label maps", self.label_maps)):
            if items is not None and len(items) != len(self.cameras):
                raise StyleSplatError(
                    f"Expected {len(self.cameras)} {what}, one per camera, got {len(items)}."
                )

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def full_cameras(self) -> Cameras:
        """The cameras at the photos' full size."""
        return self.cameras if self.full is None else self.full
