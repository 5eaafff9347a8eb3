"""From matches to poses and points."""

import shutil

from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.structure_from_motion.workplace import Workplace


def map_photos(place: Workplace) -> list[pycolmap.Reconstruction]:
    """The models that the photos give, under the names that the caller knows; the largest first.

    By COLMAP's incremental mapper: on desk the global one left out 2 to 6 of 51 photos or was half
    as exact, in the same time.

    Raises:
        StyleSplatError: If the disk is full.
    """
    shutil.rmtree(place.models, ignore_errors=True)
    place.run("map_photos", "finding poses", len(place.names), "photo", models=str(place.models))
    models = [pycolmap.Reconstruction(folder) for folder in sorted(place.models.iterdir())]
    shutil.rmtree(place.models, ignore_errors=True)
    names = dict(zip(place.files, place.names, strict=True))
    for model in models:
        for image in model.images.values():
            image.name = names[image.name]
    return sorted(models, key=lambda model: -model.num_reg_images())


def registered(model: pycolmap.Reconstruction) -> set[str]:
    """The names of the photos that have a pose."""
    return {image.name for image in model.images.values() if image.has_pose}
