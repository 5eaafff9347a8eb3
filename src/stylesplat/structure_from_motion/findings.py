"""What figures of a capture mean, in plain words, and what to do about them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import some
from stylesplat.io.captures.colmap import ModelFigures
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.one_line import counted
from stylesplat.structure_from_motion.coverage import Coverage
from stylesplat.structure_from_motion.photo_looks import PhotoLooks
from stylesplat.structure_from_motion.sharpness import BLURRED

Verdict = Literal["good", "fair", "poor"]

FEW = 20  # photos, that from one side only are too few even for that side
LEAST_SHARED = 50  # points that a photo has to share with others
LEAST_OF_USUAL = 0.1  # of what photos of the capture share in the median
ALIKE = 1.2  # ratio of distances that is not worth a number
ZOOM = 1.1  # ratio of focal lengths, beyond which lenses differ


@dataclass(frozen=True)
class Finding:
    """One line of a report."""

    what: str
    """What was looked at, in a word or two."""
    verdict: Verdict
    """How it is."""
    number: float | int | None
    """The figure that the verdict goes by."""
    says: str
    """The fact, with the figure."""
    advice: str = ""
    """What to do; empty where all is well."""

    @property
    def line(self) -> str:
        """The fact and what to do."""
        return f"{self.says}. {self.advice}".strip() if self.advice else f"{self.says}."


def graded(value: float | int, good: float | int, fair: float | int) -> Verdict:
    """A verdict on a figure by its bounds; more is better if good is more than fair."""
    sign = 1 if good > fair else -1
    if sign * value >= sign * good:
        return "good"
    return "fair" if sign * value >= sign * fair else "poor"


def on_count(count: int) -> Finding:
    """How many photos there are."""
    verdict = graded(count, 30, 15)
    advice = {"good": "", "fair": "More make it sharper: take 40 to 100."}
    few = "They are too few for most scenes: take 40 to 100."
    return Finding("photos", verdict, count, counted(count, "photo"), advice.get(verdict, few))


def on_posed(posed: int, unposed: Mapping[str, str], left_out: int) -> Finding:
    """How many of the photos have a pose, and why others have none."""
    total = posed + len(unposed)
    verdict = graded(posed / total, 0.95, 0.8)
    why = [f"{name} ({reason})" if reason else name for name, reason in unposed.items()]
    says = f"{posed} of {counted(total, 'photo')} have a pose"
    says += f", not {some(why)}" if why else ""
    says += f"; {left_out} more were left out" if left_out else ""
    advice = (
        "Take more photos between those without a pose and the rest, in small steps, and pose "
        "them again."
    )
    return _plain("posed", verdict, posed / total, says, advice)


def on_model(figures: ModelFigures) -> list[Finding]:
    """How exact a reconstruction is, and how its photos hang together."""
    error, length = figures.error, figures.track_length
    return [
        _plain(
            "reprojection error",
            graded(error, 1.5, 2.5),
            error,
            f"points lie {error:.1f} pixels beside their places in the mean",
            "Poses are vague: --refine-poses helps; leave out photos that are blurred or zoomed.",
        ),
        _plain(
            "track length",
            graded(length, 3.5, 2.7),
            length,
            f"a point shows in {length:.1f} photos in the mean",
            "Photos overlap little: take them in smaller steps, each with two thirds of the last.",
        ),
        _on_overlap(figures.shared),
    ]


def weakly_connected(shared: dict[str, int]) -> list[str]:
    """Photos that few points connect with others."""
    usual = sorted(shared.values())[len(shared) // 2]
    least = max(LEAST_SHARED, LEAST_OF_USUAL * usual)
    return [name for name, count in sorted(shared.items()) if count < least]


def _on_overlap(shared: dict[str, int]) -> Finding:
    weak = weakly_connected(shared)
    verdict = graded(len(weak) / len(shared), 0.0, 0.1)
    says = f"each photo shares {min(shared.values()):,} points or more with others"
    if weak:
        says = f"few points connect {some(weak)} with the others"
    advice = "Take photos between these and the rest, or leave them out."
    return _plain("overlap", verdict, len(weak), says, advice)


def on_points(count: int) -> Finding:
    """How many points there are to start from."""
    if not count:
        advice = "Training starts from random ones and ends with less detail."
        return Finding("points", "fair", 0, "there are no points", advice)
    advice = "Surfaces may have too little texture: add things with a pattern, take more photos."
    return _plain("points", graded(count, 2000, 500), count, f"{count:,} points", advice)


def on_sides(coverage: Coverage, photos: int) -> Finding:
    """From which sides what is in the middle is shown."""
    arc, gap = round(coverage.arc), round(coverage.largest_gap)
    if coverage.outward:
        says = f"the photos look out to {arc} of 360 degrees"
        advice = f"Turn to where {gap} degrees are missing, and take photos from several places."
        return _plain("sides", graded(arc, 300, 100), arc, says, advice)
    if arc >= 360:
        return Finding("sides", "good", 360, f"seen from all sides, every {gap} degrees or closer")
    if arc >= 120:
        says = f"seen from {arc} of 360 degrees, a gap of {gap}"
        advice = "Walk on around it, or leave it so if nobody is to look from there."
        return _plain("sides", graded(arc, 320, 120), arc, says, advice)
    if coverage.facing and arc >= 30:
        says = f"a wall, seen from the front over {arc} degrees; views from behind will be empty"
        return Finding("sides", "good", arc, says)
    if photos < FEW or arc < 30:
        says = f"{counted(photos, 'photo')} from one side only, {arc} of 360 degrees"
        return Finding("sides", "poor", arc, says, "Walk around the object.")
    says = f"seen from one side, {arc} of 360 degrees; views from behind will be empty"
    return Finding("sides", "fair", arc, says, "Walk around it if they are wanted.")


def on_heights(coverage: Coverage) -> Finding:
    """From how many heights it is shown."""
    says = f"{counted(coverage.heights, 'height')}, {coverage.elevations}"
    advice = "Go around again with the camera higher, looking down, or lower."
    return _plain("heights", graded(coverage.heights, 2, 1), coverage.heights, says, advice)


def on_distances(coverage: Coverage) -> Finding:
    """How much nearer some photos were taken than others, and whether anybody walked at all."""
    if coverage.walk < 0.1:
        says = f"the camera moved by {100 * coverage.walk:.0f} % of its distance only"
        advice = "From one spot depth cannot be told: walk, instead of turning on the spot."
        return Finding(
            "movement", "poor" if coverage.walk < 0.05 else "fair", coverage.walk, says, advice
        )
    ratio = coverage.far / max(coverage.near, 1e-9)
    says = "all photos are from about the same distance"
    if ratio > ALIKE:
        says = f"the far photos were taken from {ratio:.1f} times as far as the near ones"
    advice = "Take photos between near and far, in steps, so that they connect."
    return _plain("distances", graded(ratio, 3, 6), ratio, says, advice)


def blurred_rows(looks: PhotoLooks) -> list[int]:
    """Photos that are much less sharp than their neighbours."""
    return (looks.sharpness < BLURRED).nonzero()[:, 0].tolist()


def on_looks(looks: PhotoLooks, names: Sequence[str]) -> list[Finding]:
    """What the camera did: blur, exposure, white balance."""
    blurred = [names[row] for row in blurred_rows(looks)]
    says = f"blurred: {some(blurred)}" if blurred else "no photo is much less sharp than others"
    remedy = "Leave them out or take them again, with more light or a steadier hand."
    sharp = graded(len(blurred) / len(names), 0.0, 0.1)
    stops, warmth = _spread(looks.stops), _spread(looks.warmth)
    how = "" if looks.by_points else ", going by whole photos"
    lock = "Colour correction in training evens it out; better, lock it in the camera's app."
    slack = 1.0 if looks.by_points else 2.0  # whole photos show more or less of what is bright
    return [
        _plain("sharpness", sharp, len(blurred), says, remedy),
        _plain(
            "exposure",
            graded(stops, 0.7 * slack, 2.0 * slack),
            stops,
            f"photos differ by {stops:.1f} steps of exposure{how}",
            lock,
        ),
        _plain(
            "white balance",
            graded(warmth, 0.6 * slack, 1.5 * slack),
            warmth,
            f"red against blue differs by {warmth:.1f} steps{how}",
            lock,
        ),
    ]


def on_lenses(cameras: Cameras) -> Finding:
    """How many sizes and focal lengths there are."""
    sizes = {(w, h) for w, h in cameras.sizes.tolist()}
    # Of the longer side, so that a phone on its side counts as the same
    focal = (cameras.Ks[:, 0, 0].cpu() / cameras.sizes.amax(dim=1)).double()
    ratio = float(focal.max() / focal.min())
    says = f"{counted(len(sizes), 'size')}, one lens"
    if ratio > ZOOM:
        says = f"{counted(len(sizes), 'size')}, focal lengths that differ by {ratio:.1f} times"
    advice = "Fine for several lenses; zooming while walking makes poses vague, so do not zoom."
    return _plain("lenses", graded(ratio, ZOOM, float("inf")), ratio, says, advice)


def _plain(what: str, verdict: Verdict, number: float | int, says: str, advice: str) -> Finding:
    """A finding whose advice is given only if there is need."""
    return Finding(what, verdict, number, says, "" if verdict == "good" else advice)


def _spread(values: Float[Tensor, " C"]) -> float:
    """Between the photos on either end, but for one in twenty."""
    known = values[values.isfinite()]
    return float(known.quantile(0.95) - known.quantile(0.05)) if len(known) else 0.0
