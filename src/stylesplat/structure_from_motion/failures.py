"""Why photos give no poses, or wrong ones, and how to take better ones."""

from collections.abc import Mapping, Sequence
from statistics import median

import numpy as np

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.scene.one_line import counted
from stylesplat.scene.sampling import evenly
from stylesplat.structure_from_motion.config import MIN_PHOTOS
from stylesplat.structure_from_motion.image_measures import SOFT
from stylesplat.structure_from_motion.matching import MatchTable

FEW_FEATURES = 150  # such a photo is nearly a blank wall; ordinary ones have over a thousand
MIN_REGISTERED = 1 / 3  # share of the photos; with fewer the scene can hardly be recognised
MOSTLY_PLANAR = 0.75  # share of the matched pairs; fox has 5 %
MIN_ANGLE = 3.0  # degrees between the rays to a typical point; with less, depth is a guess
SAMPLED_POINTS = 1000
MIN_INLIERS = 30  # matches that a pose needs, COLMAP's abs_pose_min_num_inliers
# Share of the pairs with two motions, from which something turns before what stands still
MANY_MOTIONS = 0.3
WALK = "Walk around what you want to show, so that each photo is taken from another place"


def check_features(counts: Mapping[str, int], total: int) -> None:
    typical = median([*counts.values(), *[0] * (total - len(counts))])
    if typical < FEW_FEATURES:
        raise StyleSplatError(
            f"There is too little to see in the photos: {typical:.0f} features in a typical one, "
            f"at least {FEW_FEATURES} are needed. Take sharp photos, in good light, of things "
            "with texture."
        )


def check_matches(table: MatchTable) -> None:
    """Raise a StyleSplatError if too few pairs match to connect even three photos."""
    if table.matched < MIN_PHOTOS - 1:
        raise StyleSplatError(
            f"The photos do not overlap: {table.matched} of {table.compared} pairs match. Take "
            "photos of one thing, each sharing two thirds of its picture with the next."
        )


def check_models(models: Sequence[pycolmap.Reconstruction], table: MatchTable, total: int) -> None:
    """Raise a StyleSplatError unless one model shows the scene, from more than one place.

    It must have a third of the photos, and if there are other models, more than half.
    """
    sizes = [model.num_reg_images() for model in models if model.num_reg_images() >= MIN_PHOTOS]
    # Cameras that only turned say nothing about depth
    planar = table.planar >= MOSTLY_PLANAR * table.matched
    if planar and (not models or triangulation_angle(models[0]) < MIN_ANGLE):
        raise StyleSplatError(
            f"The photos were taken from one place, or show only something flat: in {table.planar} "
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
    if sizes[0] < MIN_REGISTERED * total:
        raise StyleSplatError(
            f"Only {sizes[0]} of {total} photos fit together: {table.matched} of {table.compared} "
            f"pairs match. {WALK}, at small steps, each sharing two thirds of its picture with "
            "the next."
        )


def two_motions(share: float) -> str | None:
    """What to do where an object turns before a still background; None where none does."""
    if share < MANY_MOTIONS:
        return None
    return (
        f"In {share:.0%} of the pairs of photos much stays in its place while the rest moves: an "
        "object that turns before a still background. Poses can only fit one of the two. Draw a "
        "box around the object in one photo, --object VIEW:x0,y0,x1,y1, or give its --masks."
    )


def triangulation_angle(model: pycolmap.Reconstruction) -> float:
    """Degrees between the outermost rays to a typical point; 0 if there are no points."""
    centres = {key: model.image(key).projection_center() for key in model.reg_image_ids()}

    def widest(point: pycolmap.Point3D) -> float:
        rays = np.stack([centres[e.image_id] - point.xyz for e in point.track.elements])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return float(np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1.0, 1.0))))

    points = evenly([*model.points3D.values()], SAMPLED_POINTS)
    return float(np.median([widest(point) for point in points])) if points else 0.0


def why_unregistered(
    models: Sequence[pycolmap.Reconstruction],
    counts: Mapping[str, int],
    sharpness: Mapping[str, float],
    table: MatchTable,
    names: Sequence[str],
) -> dict[str, str]:
    """By name the reason, for each photo that the first model lacks."""
    posed, *others = [{i.name for i in m.images.values() if i.has_pose} for m in models]

    def reason(name: str) -> str:
        if name not in counts:
            return "it cannot be decoded"
        if sharpness.get(name, 1.0) < SOFT:
            return f"blurred: {sharpness[name]:.0%} as sharp as its neighbours"
        if counts[name] < FEW_FEATURES:
            return f"too little texture: {counts[name]} features"
        if any(name in group for group in others):
            return "sees another place than the rest, together with other photos"
        shared = max((table.matches.get((name, other), 0) for other in posed), default=0)
        if shared < MIN_INLIERS:
            return (
                "too far from the others: no photo with a pose shares more than "
                f"{counted(shared, 'feature')} with it, {MIN_INLIERS} are needed"
            )
        return (
            f"no camera position fits, though it shares {shared} features with a photo that has a "
            "pose: things that repeat or moved mislead, or the camera only turned"
        )

    return {name: reason(name) for name in names if name not in posed}
