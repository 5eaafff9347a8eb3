"""From photos to cameras and points."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stylesplat.io.atomic import changing
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.structure_from_motion.failures import (
    check_features,
    check_matches,
    check_models,
    check_number,
)
from stylesplat.structure_from_motion.keypoints import find_keypoints, keypoint_counts
from stylesplat.structure_from_motion.mapper import map_photos
from stylesplat.structure_from_motion.match_table import match_table
from stylesplat.structure_from_motion.pairs import match_photos
from stylesplat.structure_from_motion.prepared import Prepared
from stylesplat.structure_from_motion.sfm_config import SfmConfig
from stylesplat.structure_from_motion.undistort import firm_points
from stylesplat.structure_from_motion.unregistered import why_unregistered
from stylesplat.structure_from_motion.workplace import open_workplace

USUAL = SfmConfig()


@dataclass(frozen=True)
class Reconstruction:
    """Where photos were taken, and what they see."""

    model: pycolmap.Reconstruction
    """The largest group of photos that fit together, under the names that they were given with."""
    unregistered: dict[str, str]
    """By name why a photo is not in it."""
    numbers: dict[str, Any]
    """What was measured."""


def reconstruct(
    photos: Path, prepared: Prepared, work: Path, *, config: SfmConfig = USUAL
) -> Reconstruction:
    """Find features, match them and map the photos.

    An interrupted call loses nothing that its database holds: the next one with the same photos
    and settings goes on.

    Args:
        photos: Upright photos.
        prepared: Which of them to use.
        work: A folder for the database; it is made as needed, and may be deleted afterwards.
        config: How to do it.

    Raises:
        StyleSplatError: If there are fewer than 3 photos, they have too little texture, do not
            overlap, show different places or were taken from one place, or if the disk is full.
    """
    check_number(len(prepared.names))
    seconds: dict[str, float] = {}
    with changing(work):
        with _timed(seconds, "features"):
            place = open_workplace(work, photos, prepared.names, config)
            find_keypoints(place)
        counts = keypoint_counts(place)
        check_features(counts, len(prepared.names))
        with _timed(seconds, "matching"):
            match_photos(place, ordered=prepared.ordered)
        table = match_table(place)
        check_matches(table)
        with _timed(seconds, "mapping"):
            models = map_photos(place)
    check_models(models, table, len(prepared.names))
    model = models[0]
    return Reconstruction(
        model=model,
        unregistered=why_unregistered(models, counts, prepared.sharpness, table, prepared.names),
        numbers={
            "photos": len(prepared.names),
            "registered": model.num_reg_images(),
            "points": len(firm_points(model)),
            "reprojection_error": model.compute_mean_reprojection_error(),
            "compared_pairs": table.compared,
            "matched_pairs": table.matched,
            "models": len(models),
            "seconds": seconds,
        },
    )


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[stage] = round(time.perf_counter() - start, 2)
