"""When photos give no poses, or wrong ones: the fact, and how to take better ones."""

from collections.abc import Mapping, Sequence
from statistics import median

import numpy as np

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.scene.sampling import evenly
from stylesplat.structure_from_motion.match_table import MatchTable
from stylesplat.structure_from_motion.prepared import LEAST
from stylesplat.structure_from_motion.unregistered import FEW_FEATURES

POSED = 1 / 3  # of the photos: of fewer the scene is hardly to be recognised
MOSTLY_FLAT = 0.75  # of the matched pairs; fox has 5 % of them
NARROW = 3.0  # degrees between the rays to a typical point, below which depth is a guess
LOOKED_AT = 1000  # points
WALK = "Walk around what you want to show, so that each photo is taken from another place"


def check_number(count: int) -> None:
    """Raise a StyleSplatError for too few photos."""
    if count < LEAST:
        raise StyleSplatError(
            f"Poses need at least {LEAST} photos, there {'is' if count == 1 else 'are'} {count}. "
            "Take 30 to 100, from all sides."
        )


def check_features(counts: Mapping[str, int], total: int) -> None:
    """Raise a StyleSplatError if there is hardly anything to see in the photos."""
    typical = median([*counts.values(), *[0] * (total - len(counts))])
    if typical < FEW_FEATURES:
        raise StyleSplatError(
            f"There is too little to see in the photos: {typical:.0f} features in a typical one, "
            f"at least {FEW_FEATURES} are needed. Take sharp photos, in good light, of things "
            "with texture."
        )


def check_matches(table: MatchTable) -> None:
    """Raise a StyleSplatError if too few pairs match to connect even three photos."""
    if table.matched < LEAST - 1:
        raise StyleSplatError(
            f"The photos do not overlap: {table.matched} of {table.compared} pairs match. Take "
            "photos of one thing, each sharing two thirds of its picture with the next."
        )


def check_models(models: Sequence[pycolmap.Reconstruction], table: MatchTable, total: int) -> None:
    """Raise a StyleSplatError unless one model shows the scene, from more than one place.

    It has a third of the photos at least, and if there are others, more than half.

    Args:
        models: The largest first.
        table: What was compared.
        total: How many photos there are.
    """
    sizes = [model.num_reg_images() for model in models if model.num_reg_images() >= LEAST]
    if _is_turn(models, table):
        raise StyleSplatError(
            f"The photos were taken from one place, or show only something flat: in {table.flat} "
            f"of {table.matched} matching pairs nothing shifts before anything else. {WALK}."
        )
    if not sizes:
        raise StyleSplatError(
            f"No three of the {total} photos fit together, though {table.matched} of "
            f"{table.compared} pairs match. {WALK}, at small steps."
        )
    if len(sizes) > 1 and 2 * sizes[0] <= total:
        raise StyleSplatError(
            f"The photos show different places: they fall into groups of "
            f"{', '.join(map(str, sizes))} of {total}. Put each place into a folder of its own, "
            "or take photos that connect them."
        )
    if sizes[0] < POSED * total:
        raise StyleSplatError(
            f"Only {sizes[0]} of {total} photos fit together: {table.matched} of {table.compared} "
            f"pairs match. {WALK}, at small steps, each sharing two thirds of its picture with "
            "the next."
        )


def _is_turn(models: Sequence[pycolmap.Reconstruction], table: MatchTable) -> bool:
    """Whether the cameras only turned, so that nothing is known of depth."""
    if table.flat < MOSTLY_FLAT * table.matched:
        return False
    return not models or angle_of_view(models[0]) < NARROW


def angle_of_view(model: pycolmap.Reconstruction) -> float:
    """Degrees between the outermost rays to a typical point; 0 if there are none."""
    centres = {key: model.image(key).projection_center() for key in model.reg_image_ids()}
    points = evenly([*model.points3D.values()], LOOKED_AT)
    return float(np.median([_widest(p, centres) for p in points])) if points else 0.0


def _widest(point: pycolmap.Point3D, centres: Mapping[int, np.ndarray]) -> float:
    rays = np.stack([centres[e.image_id] - point.xyz for e in point.track.elements])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return float(np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1.0, 1.0))))
