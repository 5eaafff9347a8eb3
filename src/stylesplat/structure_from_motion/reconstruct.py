"""From photos to cameras and points."""

import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stylesplat.io.atomic import changing
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.structure_from_motion.config import SfmConfig
from stylesplat.structure_from_motion.failures import (
    check_features,
    check_matches,
    check_models,
    why_unregistered,
)
from stylesplat.structure_from_motion.matching import match_pairs
from stylesplat.structure_from_motion.photo_folder import PreparedPhotos
from stylesplat.structure_from_motion.undistort import reliable_points
from stylesplat.structure_from_motion.workspace import (
    Workspace,
    extract_features,
    feature_counts,
    open_workspace,
)

STAGES = ("features", "matching", "mapping")


@dataclass(frozen=True)
class Reconstruction:
    """Where photos were taken, and the points that they show."""

    model: pycolmap.Reconstruction
    """The largest group of photos that fit together, under the caller's names."""
    unregistered: dict[str, str]
    """By name why a photo is not in it."""
    numbers: dict[str, Any]
    """Counts, the mean reprojection error and the seconds of each stage."""


def reconstruct(
    photos: Path, prepared: PreparedPhotos, work: Path, *, config: SfmConfig
) -> Reconstruction:
    """Extract features, match them and map the photos.

    An interrupted call loses nothing that its database holds: the next one with the same photos
    and settings continues.
    """
    names, times = prepared.names, [time.perf_counter()]
    with changing(work):
        workspace = open_workspace(work, photos, names, config)
        extract_features(workspace)
        counts = feature_counts(workspace)
        check_features(counts, len(names))
        times.append(time.perf_counter())
        table = match_pairs(workspace, ordered=prepared.ordered)
        check_matches(table)
        times.append(time.perf_counter())
        models = _map_photos(workspace)
        times.append(time.perf_counter())
    check_models(models, table, len(names))
    model = models[0]
    return Reconstruction(
        model=model,
        unregistered=why_unregistered(models, counts, prepared.sharpness, table, names),
        numbers={
            "photos": len(names),
            "registered": model.num_reg_images(),
            "points": len(reliable_points(model)),
            "reprojection_error": model.compute_mean_reprojection_error(),
            "compared_pairs": table.compared,
            "matched_pairs": table.matched,
            "models": len(models),
            "seconds": {
                stage: round(end - start, 2)
                for stage, start, end in zip(STAGES, times, times[1:], strict=False)
            },
        },
    )


def _map_photos(workspace: Workspace) -> list[pycolmap.Reconstruction]:
    """The models of the photos, under the caller's names; the largest first.

    By COLMAP's incremental mapper: on desk the global one left out 2 to 6 of 51 photos or was half
    as exact, in the same time.
    """
    folder = workspace.folder / "models"
    shutil.rmtree(folder, ignore_errors=True)
    workspace.run("map_photos", "finding poses", len(workspace.names), "photo", models=str(folder))
    models = [pycolmap.Reconstruction(each) for each in sorted(folder.iterdir())]
    shutil.rmtree(folder, ignore_errors=True)
    for model in models:
        for image in model.images.values():
            image.name = workspace.name_of[image.name]
    return sorted(models, key=lambda model: -model.num_reg_images())
