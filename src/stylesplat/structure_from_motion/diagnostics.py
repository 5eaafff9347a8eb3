"""What the statistics of a capture mean, why photos give no poses, and what to do."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError, count_noun, join_names, noun_repr
from stylesplat.io.captures.colmap import ModelFigures
from stylesplat.photo_libraries import pycolmap
from stylesplat.scene.frames import Frame
from stylesplat.scene.outliers import Outliers
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.structure_from_motion.config import MIN_PHOTOS
from stylesplat.structure_from_motion.image_measures import BLURRED, MEASURE_SOFT
from stylesplat.structure_from_motion.matching import MatchTable
from stylesplat.structure_from_motion.world_frame import Coverage, PhotoStatistics

Verdict = Literal["good", "fair", "poor"]

DIAGNOSIS_FEW = 20  # photos; with fewer from one side only, even that side is poor
MIN_SHARED = 50  # points that a photo has to share with others
MIN_SHARED_SHARE = 0.1  # of what photos of the capture share in the median
SAME_DISTANCE = 1.2  # ratio of distances that is not worth a number
ANOTHER_PLACE = "shows another place"  # how the reason begins that such a photo has no pose


@dataclass(frozen=True)
class Finding:
    what: str
    verdict: Verdict
    number: float | int | None
    """The figure that the verdict depends on."""
    says: str
    advice: str = ""
    """What to do; empty where all is well."""

    @property
    def line(self) -> str:
        return f"{self.says}. {self.advice}".strip() if self.advice else f"{self.says}."


@dataclass(frozen=True, eq=False)
class CaptureReport:
    findings: tuple[Finding, ...]
    blurred: tuple[str, ...]
    """Photos that are much less sharp than their neighbours."""
    weak: tuple[str, ...]
    """Photos that few points connect with the others."""
    coverage: Coverage
    frame: Frame
    """Where up is -y, the content is in the middle and the cameras' median distance is 1."""

    def __repr__(self) -> str:
        return noun_repr(self, *(f"{each.what}: {each.verdict}" for each in self.findings))

    def summary(self) -> dict[str, Any]:
        """The same as plain values, for JSON."""
        lines = {each.what: asdict(each) for each in self.findings}
        for line in lines.values():
            del line["what"]
        return {"findings": lines, "blurred": list(self.blurred), "weak": list(self.weak)}


def diagnose_count(count: int) -> Finding:
    fault = "They are too few for most scenes" if count < 15 else "More make it sharper"
    advice = f"{fault}: take 40 to 100."
    return _graded("photos", count, (30, 15), count_noun(count, "photo"), advice)


def diagnose_poses(posed: int, unposed: Mapping[str, str], left_out: int) -> Finding:
    """How many of the photos have a pose, and why others have none."""
    total = posed + len(unposed)
    why = [f"{name} ({reason})" if reason else name for name, reason in unposed.items()]
    says = f"{posed} of {count_noun(total, 'photo')} have a pose"
    says += f", not {join_names(why)}" if why else ""
    says += f"; {left_out} more were left out" if left_out else ""
    advice = (
        "Take more photos between those without a pose and the rest, in small steps, and pose "
        "them again."
    )
    if unposed and all(reason.startswith(ANOTHER_PLACE) for reason in unposed.values()):
        advice = "Pose each place in a folder of its own, or take photos that connect them."
    return _graded("posed", posed / total, (0.95, 0.8), says, advice)


def diagnose_outliers(outliers: Outliers) -> Finding:
    """What lies so far from all else that it is left out."""
    count = len(outliers.photos) + outliers.points
    advice = "They are left out"
    advice += "; pose these photos again if they matter." if outliers.photos else "."
    return Finding("outliers", "fair", count, str(outliers), advice)


def diagnose_model(figures: ModelFigures) -> list[Finding]:
    """How exact a reconstruction is, and how well its photos are connected."""
    error, length, shared = figures.error, figures.track_length, figures.shared
    weak = weakly_connected(shared)
    overlap = f"each photo shares {min(shared.values()):,} points or more with others"
    if weak:
        overlap = f"few points connect {join_names(weak)} with the others"
    vague = "Poses are vague: --refine-poses helps; leave out photos that are blurred or zoomed."
    mean = f"the mean reprojection error is {error:.1f} pixels" if error is not None else ""
    return [
        *([] if error is None else [_graded("reprojection error", error, (1.5, 2.5), mean, vague)]),
        _graded(
            "track length",
            length,
            (3.5, 2.7),
            f"a point is seen in {length:.1f} photos on average",
            "Photos overlap little: take them in smaller steps, each with two thirds of the last.",
        ),
        _graded(
            "overlap",
            len(weak),
            (0, 0.1 * len(shared)),
            overlap,
            "Take photos between these and the rest, or leave them out.",
        ),
    ]


def weakly_connected(shared: dict[str, int]) -> list[str]:
    typical = sorted(shared.values())[len(shared) // 2]
    least = max(MIN_SHARED, MIN_SHARED_SHARE * typical)
    return [name for name, count in sorted(shared.items()) if count < least]


def diagnose_points(count: int) -> Finding:
    if not count:
        advice = "Training starts from random ones and ends with less detail."
        return Finding("points", "fair", 0, "there are no points", advice)
    advice = "Surfaces may have too little texture: add things with a pattern, take more photos."
    return _graded("points", count, (2000, 500), f"{count:,} points", advice)


def diagnose_sides(coverage: Coverage, photos: int) -> Finding:
    """From which sides the photos show the middle."""
    arc, gap = round(coverage.arc), round(coverage.largest_gap)
    if coverage.outward:
        says = f"the photos look out to {arc} of 360 degrees"
        advice = f"Turn to where {gap} degrees are missing, and take photos from several places."
        return _graded("sides", arc, (300, 100), says, advice)
    if arc >= 360:
        return Finding("sides", "good", 360, f"seen from all sides, every {gap} degrees or closer")
    if arc >= 120:
        says = f"seen from {arc} of 360 degrees, a gap of {gap}"
        advice = "Walk on around it, or leave it so if nobody is to look from there."
        return _graded("sides", arc, (320, 120), says, advice)
    if photos < DIAGNOSIS_FEW or arc < 30:
        says = f"{count_noun(photos, 'photo')} from one side only, {arc} of 360 degrees"
        return Finding("sides", "poor", arc, says, "Walk around the object.")
    says = f"seen from one side, {arc} of 360 degrees; views from behind will be empty"
    return Finding("sides", "fair", arc, says, "Walk around it if they are wanted.")


def diagnose_heights(coverage: Coverage) -> Finding:
    says = f"{count_noun(coverage.heights, 'height')}, {coverage.elevations}"
    advice = "Go around again with the camera higher, looking down, or lower."
    return _graded("heights", coverage.heights, (2, 1), says, advice)


def diagnose_distances(coverage: Coverage) -> Finding:
    """How much nearer some photos were taken than others, and whether the camera moved at all."""
    if coverage.walk < 0.1:
        says = f"the camera moved by {100 * coverage.walk:.0f} % of its distance only"
        advice = "From one spot depth cannot be told: walk, instead of turning on the spot."
        verdict = "poor" if coverage.walk < 0.05 else "fair"
        return Finding("movement", verdict, coverage.walk, says, advice)
    ratio = coverage.far / max(coverage.near, 1e-9)
    says = "all photos are from about the same distance"
    if ratio > SAME_DISTANCE:
        says = f"the far photos were taken from {ratio:.1f} times as far as the near ones"
    advice = "Take photos between near and far, in steps, so that they connect."
    return _graded("distances", ratio, (3, 6), says, advice)


def blurred_rows(photos: PhotoStatistics) -> list[int]:
    return (photos.sharpness < BLURRED).nonzero()[:, 0].tolist()


def diagnose_photos(photos: PhotoStatistics, names: Sequence[str]) -> list[Finding]:
    blurred = [names[row] for row in blurred_rows(photos)]
    stops, warmth = _range(photos.stops), _range(photos.warmth)
    basis = "" if photos.by_points else ", going by whole photos"
    lock = "Colour correction in training evens it out; better, lock it in the camera's app."
    slack = 1.0 if photos.by_points else 2.0  # whole photos show more or less of what is bright
    return [
        _graded(
            "sharpness",
            len(blurred),
            (0, 0.1 * len(names)),
            f"blurred: {join_names(blurred)}"
            if blurred
            else "no photo is much less sharp than others",
            "Leave them out or take them again, with more light or a steadier hand.",
        ),
        _graded(
            "exposure",
            stops,
            (0.7 * slack, 2.0 * slack),
            f"photos differ by {stops:.1f} steps of exposure{basis}",
            lock,
        ),
        _graded(
            "white balance",
            warmth,
            (0.6 * slack, 1.5 * slack),
            f"red against blue differs by {warmth:.1f} steps{basis}",
            lock,
        ),
    ]


def _graded(
    what: str, number: float | int, bounds: tuple[float | int, float | int], says: str, advice: str
) -> Finding:
    """A finding on a number, with advice unless it is good; more is better if good > fair."""
    good, fair = bounds
    sign = 1 if good > fair else -1
    if sign * number >= sign * good:
        return Finding(what, "good", number, says)
    return Finding(what, "fair" if sign * number >= sign * fair else "poor", number, says, advice)


def _range(values: Float[Tensor, " C"]) -> float:
    """From the 5th to the 95th percentile of the known values."""
    known = values[values.isfinite()]
    return float(known.quantile(0.95) - known.quantile(0.05)) if len(known) else 0.0


FEW_FEATURES = 150  # such a photo is nearly a blank wall; ordinary ones have over a thousand
# Share of the photos, with fewer of which a scene can hardly be recognised, unless they are so many
MIN_REGISTERED, ENOUGH = 1 / 3, 12
MOSTLY_PLANAR = 0.75  # share of the matched pairs; fox has 5 %
MIN_ANGLE = 3.0  # degrees between the rays to a typical point; with less, depth is a guess
SAMPLED_POINTS = 1000
MIN_INLIERS = 30  # matches that a pose needs at first, COLMAP's abs_pose_min_num_inliers
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


def is_without_depth(models: Sequence[pycolmap.Reconstruction], table: MatchTable) -> bool:
    """Whether the camera only turned, which says nothing about depth, or everything is flat."""
    planar = table.planar >= MOSTLY_PLANAR * table.matched
    return planar and (not models or triangulation_angle(models[0]) < MIN_ANGLE)


def are_apart(models: Sequence[pycolmap.Reconstruction], table: MatchTable) -> bool:
    """Whether the photos fall into groups that no match joins, such as photos of two rooms."""
    groups = [{i.name for i in m.images.values() if i.has_pose} for m in models]
    group_of = {name: row for row, group in enumerate(groups) for name in group}
    return len(groups) > 1 and not any(
        group_of.get(one, -1) != group_of.get(other, -1)
        for (one, other), count in table.matches.items()
        if count >= MIN_INLIERS
    )


def check_models(models: Sequence[pycolmap.Reconstruction], table: MatchTable, total: int) -> None:
    """Raise a StyleSplatError unless one model shows the scene, from more than one place.

    It must have a third of the photos, or 12: a collection may show several places.
    """
    sizes = [model.num_reg_images() for model in models if model.num_reg_images() >= MIN_PHOTOS]
    if is_without_depth(models, table):
        raise StyleSplatError(
            f"The photos were taken from one place, or show only something flat: in {table.planar} "
            f"of {table.matched} matching pairs nothing shifts before anything else. {WALK}."
        )
    if not sizes:
        raise StyleSplatError(
            f"No three of the {total} photos fit together, though {table.matched} of "
            f"{table.compared} pairs match. {WALK}, at small steps."
        )
    if sizes[0] >= min(MIN_REGISTERED * total, ENOUGH):
        return
    if len(sizes) > 1:
        raise StyleSplatError(
            f"The photos show different places: they fall into groups of "
            f"{', '.join(map(str, sizes))} of {total}. Put each place into a folder of its own, "
            "or take photos that connect them."
        )
    raise StyleSplatError(
        f"Only {sizes[0]} of {total} photos fit together: {table.matched} of {table.compared} "
        f"pairs match. {WALK}, at small steps, each sharing two thirds of its picture with "
        "the next."
    )


class TurningNotPosed(StyleSplatError):
    """An object turns before a still background, and its poses were not found."""

    def __init__(self, fault: str, photo: str, box: Sequence[int | float]) -> None:
        super().__init__(fault)
        self.photo, self.box = photo, box  # around what turns


def triangulation_angle(model: pycolmap.Reconstruction) -> float:
    """Degrees between the outermost rays to a typical point; 0 if there are no points."""
    centres = {key: model.image(key).projection_center() for key in model.reg_image_ids()}

    def widest(point: pycolmap.Point3D) -> float:
        rays = np.stack([centres[e.image_id] - point.xyz for e in point.track.elements])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return float(np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1.0, 1.0))))

    points = evenly_spaced([*model.points3D.values()], SAMPLED_POINTS)
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
        if sharpness.get(name, 1.0) < MEASURE_SOFT:
            return f"blurred: {sharpness[name]:.0%} as sharp as its neighbours"
        if counts[name] < FEW_FEATURES:
            return f"too little texture: {counts[name]} features"
        for group in others:
            if name in group:
                return f"{ANOTHER_PLACE}, with {count_noun(len(group) - 1, 'other photo')}"
        shared = max((table.matches.get((name, other), 0) for other in posed), default=0)
        if shared < MIN_INLIERS:
            return (
                "too far from the others: no photo with a pose shares more than "
                f"{count_noun(shared, 'feature')} with it, and a reliable pose takes "
                f"{MIN_INLIERS}. Take photos between it and the others"
            )
        return (
            f"no camera position fits, though it shares {shared} features with a photo that has a "
            "pose: things that repeat or moved mislead, or the camera only turned"
        )

    return {name: reason(name) for name in names if name not in posed}
