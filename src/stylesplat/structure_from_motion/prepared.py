"""What structure from motion goes by: photos that are fit for it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from stylesplat.io.json_files import PhotoName

LEAST = 3  # photos from which anything can be reconstructed


@dataclass(frozen=True)
class Prepared:
    """Upright photos in one folder, and what became of the others."""

    names: tuple[PhotoName, ...]
    """Paths relative to the folder, with `/` between the parts, in order."""
    ordered: bool
    """Whether neighbours in the list were neighbours in time: a video, or numbered frames."""
    origins: Mapping[PhotoName, str]
    """By name what the user calls it: a path in their folder, or a frame and its time."""
    sharpness: Mapping[PhotoName, float]
    """By name, relative to what is usual among its neighbours: 1 is typical, less is blurred."""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """By the user's own name why a photo was left out, in a few words."""
