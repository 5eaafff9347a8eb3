"""Settings of structure from motion."""

from dataclasses import dataclass
from typing import Literal

from stylesplat.errors import StyleSplatError

Matching = Literal["auto", "exhaustive", "sequential", "similar"]
CameraSharing = Literal["auto", "one", "several"]
MIN_PHOTOS = 3  # fewer cannot be reconstructed
MIN_SIZE, MIN_FEATURES = 100, 100  # smaller settings find nothing


@dataclass(frozen=True)
class SfmConfig:
    matching: Matching = "auto"
    """Which photos are compared: all with all, each with the next ones, or those that look alike;
    auto goes by their number and order."""
    cameras: CameraSharing = "auto"
    """One lens for all photos of a size and a camera, one for all of a size, or one for each."""
    max_size: int = 1600
    """Pixels of the longer side for feature extraction; larger photos are scaled down."""
    max_features: int = 2048
    """Features per photo; if there are more, the largest are kept."""
    seed: int = 0
    """The same seed and number of threads give the same poses."""

    def __post_init__(self) -> None:
        if self.max_size < MIN_SIZE or self.max_features < MIN_FEATURES:
            raise StyleSplatError(
                f"max_size {self.max_size} and max_features {self.max_features} find nothing. "
                f"Use at least {MIN_SIZE} and {MIN_FEATURES}."
            )
