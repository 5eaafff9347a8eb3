"""What a COLMAP model tells of how well its photos hold together."""

from dataclasses import dataclass
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap import MALFORMED, find_sparse
from stylesplat.io.captures.colmap_check import check_complete
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.io.files import reason


@dataclass(frozen=True)
class ModelFigures:
    """Figures of a model whose points know the photos that they were found in."""

    error: float
    """Mean distance in pixels between where a photo shows a point and where it should."""
    track_length: float
    """How many photos a point was found in, in the mean."""
    shared: dict[str, int]
    """By posed photo how many of its points other photos show too."""


def read_figures(folder: Path) -> ModelFigures | None:
    """Read the figures of a capture; None if it has no COLMAP model, or points without tracks.

    Raises:
        StyleSplatError: If a file of the model is damaged.
    """
    sparse = find_sparse(folder)
    if sparse is None:
        return None
    check_complete(sparse)
    try:
        model = pycolmap.Reconstruction(sparse)
        if not model.compute_num_observations():
            return None
        return ModelFigures(
            error=model.compute_mean_reprojection_error(),
            track_length=model.compute_mean_track_length(),
            shared={i.name: i.num_points3D for i in model.images.values() if i.has_pose},
        )
    except MALFORMED as error:
        raise StyleSplatError(
            f"Cannot read the reconstruction {sparse}: {reason(error)}. Copy it again."
        ) from error
