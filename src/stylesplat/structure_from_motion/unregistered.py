"""Why photos have no pose, by what was measured, in words for those who took them."""

from collections.abc import Mapping, Sequence

from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.scene.one_line import counted
from stylesplat.structure_from_motion.mapper import registered
from stylesplat.structure_from_motion.match_table import MatchTable
from stylesplat.structure_from_motion.sharpness import SOFT

POINTS = 30  # that a pose needs to fit, COLMAP's abs_pose_min_num_inliers
FEW_FEATURES = 150  # such a photo is nearly a blank wall; ordinary ones have over a thousand


def why_unregistered(
    models: Sequence[pycolmap.Reconstruction],
    counts: Mapping[str, int],
    sharpness: Mapping[str, float],
    table: MatchTable,
    names: Sequence[str],
) -> dict[str, str]:
    """By name the reason, for each photo that the first model lacks.

    Args:
        models: The largest first.
        counts: Features by name.
        sharpness: By name; 1 is usual.
        table: What was compared.
        names: All photos.
    """
    groups = [registered(model) for model in models]
    missing = [name for name in names if name not in groups[0]]
    return {
        name: _quality(name, counts, sharpness) or _place(name, groups, table) for name in missing
    }


def _quality(name: str, counts: Mapping[str, int], sharpness: Mapping[str, float]) -> str | None:
    """What is wrong with the photo itself."""
    if name not in counts:
        return "it cannot be decoded"
    if sharpness.get(name, 1.0) < SOFT:
        return f"blurred: {sharpness[name]:.0%} as sharp as its neighbours"
    if counts[name] < FEW_FEATURES:
        return f"too little texture: {counts[name]} features"
    return None


def _place(name: str, groups: Sequence[set[str]], table: MatchTable) -> str:
    """How it lies to the others."""
    partners = table.partners(name)
    shared = max((partners[other] for other in groups[0]), default=0)
    together = next((group for group in groups[1:] if name in group), None)
    if together is not None:
        others = len(together) - 1
        return f"sees another place than the rest, together with {others} other photos"
    if not partners:
        return "too far from the others: it matches none of them"
    if not shared:
        return "sees another place than the rest: it matches none of the photos with a pose"
    if shared < POINTS:
        return (
            "too far from the others: no photo with a pose shares more than "
            f"{counted(shared, 'feature')} with it, {POINTS} are needed"
        )
    return (
        f"no camera position fits, though it shares {shared} features with a photo that has a "
        "pose: things that repeat or moved mislead, or the camera only turned"
    )
