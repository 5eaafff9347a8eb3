"""Settings of structure from motion."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from stylesplat.options import MANY, Config, Option, Seed

Matching = Literal["auto", "exhaustive", "sequential", "similar"]
CameraSharing = Literal["auto", "one", "several"]
MIN_PHOTOS = 3  # fewer cannot be reconstructed


@dataclass(frozen=True)
class SfmConfig(Config):
    verb: ClassVar = "find cameras"
    matching: Matching = "auto"
    """Which photos are compared: all with all, each with the next ones, or those that look alike;
    auto goes by their number and order."""
    cameras: CameraSharing = "auto"
    """One lens for all photos of a size and a camera, one for all of a size, or one for each."""
    max_size: Annotated[int, Option(100, MANY, research=True)] = 1600
    """Pixels of the longer side for feature extraction; larger photos are scaled down."""
    max_features: Annotated[int, Option(100, MANY, research=True)] = 2048
    """Features per photo; if there are more, the largest are kept."""
    seed: Seed = 0
    """The same seed and number of threads give the same poses."""
