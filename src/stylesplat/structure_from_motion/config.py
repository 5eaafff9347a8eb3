"""Settings of structure from motion."""

from dataclasses import dataclass

from stylesplat.errors import StyleSplatError, check_choice

MATCHING = ("auto", "exhaustive", "sequential", "similar")
CAMERAS = ("auto", "one", "several")
MIN_PHOTOS = 3  # fewer cannot be reconstructed
MIN_SIZE, MIN_FEATURES = 100, 100  # smaller settings find nothing


@dataclass(frozen=True)
class SfmConfig:
    matching: str = "auto"
    """Which pairs of photos to match: all, those near in time, or those that look alike."""
    cameras: str = "auto"
    """One camera a photo size and lens (auto), one a size, or several: each photo its own."""
    max_size: int = 1600
    """Pixels of the longer side for feature extraction; larger photos are scaled down."""
    max_features: int = 2048
    """Features per photo; if there are more, the largest are kept."""
    seed: int = 0
    """Seed of all random numbers; the same seed and thread count reproduce a run."""

    def __post_init__(self) -> None:
        check_choice(self.matching, "matching", MATCHING)
        check_choice(self.cameras, "choice of cameras", CAMERAS)
        if self.max_size < MIN_SIZE or self.max_features < MIN_FEATURES:
            raise StyleSplatError(
                f"max_size {self.max_size} and max_features {self.max_features} find nothing. "
                f"Use at least {MIN_SIZE} and {MIN_FEATURES}."
            )
