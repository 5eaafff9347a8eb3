"""Objects by label: decoded identities, the members of a label, picks by boxes and points.

All objects are found in one pass, without a table of all Gaussians by all labels. Outliers are left
out, gaps are filled.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, shell_command
from stylesplat.options import check_box, check_point
from stylesplat.rendering.render import render
from stylesplat.rendering.weights import COVERED
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND
from stylesplat.scene.content import EXTENT_FAINT
from stylesplat.scene.neighbors import nearest_points
from stylesplat.scene.projection import overlapping
from stylesplat.scene.selection import THRESHOLD, Point, ViewBox
from stylesplat.scene.splats import Classifier, Splats

UNLABELLED = (
    "Train from a capture with label maps, or import with one (`object_mask/` or --masks); of a "
    "splat without photos `stylesplat mask SCENE --box NAME=VIEW:x0,y0,x1,y1` makes some; or "
    "select without labels, with --point, --box3d or --sphere."
)


def require_identities(splats: Splats) -> tuple[Float[Tensor, "N 16"], Classifier]:
    """The identities and their classifier; refuses splats without."""
    if splats.identities is None or splats.classifier is None:
        raise StyleSplatError(
            f"These splats have no identities, so no objects are known. {UNLABELLED}"
        )
    return splats.identities, splats.classifier


def object_ids(splats: Splats) -> tuple[int, ...]:
    """The label ids of all objects, in ascending order; refuses splats without identities."""
    _, classifier = require_identities(splats)
    return tuple(sorted(set(classifier.ids) - {BACKGROUND}))


def labels_around(
    splats: Splats, camera: Cameras, pixels: Bool[Tensor, "H W"]
) -> Int[Tensor, "H W"]:
    """The labels in a box around some pixels; background elsewhere."""
    low = [int(pixels.any(dim=axis).nonzero().min()) for axis in (0, 1)]
    high = [int(pixels.any(dim=axis).nonzero().max()) + 1 for axis in (0, 1)]
    cut = camera.crop(low, [b - a for a, b in zip(low, high, strict=True)])
    labels = torch.full_like(pixels, BACKGROUND, dtype=torch.int32)
    labels[low[1] : high[1], low[0] : high[0]] = render_labels(splats, cut)
    return labels


@torch.no_grad()
def render_labels(splats: Splats, camera: Cameras) -> Int[Tensor, "H W"]:
    """The label map of one camera: the label id of each pixel's composited identity.

    A pixel is background where the Gaussians cover less than half of it.
    """
    identities, classifier = require_identities(splats)
    image, alphas = render(splats, camera, features=identities, sh_degree=0)
    labels = classifier.likeliest(image[..., 3:])
    return torch.where(alphas[..., 0] < COVERED, BACKGROUND, labels)


MEMBER_SURE = (0.5, 0.9)  # probability above which a Gaussian is another object's; the background's
CONFIRMED = 0.9  # probability above which label maps confirm a Gaussian's label
MEMBER_AT_ONCE = 1 << 20  # Gaussians whose identities are gathered: 64 MB


@dataclass(frozen=True, eq=False)
class Members:
    """The Gaussians of some label ids by their identities alone."""

    splats: Splats
    likely: Mapping[int, Int[Tensor, " _"]]
    """By id the Gaussians whose probability exceeds the threshold."""
    confirmed: Mapping[int, Bool[Tensor, " _"]]
    """Whether label maps confirm them."""

    def mask(self, id: int) -> Bool[Tensor, " N"]:
        """The likely Gaussians of an object."""
        nobody = torch.zeros(len(self.splats), dtype=torch.bool, device=self.splats.device)
        return nobody.index_fill(0, self.likely[id], True)

    @torch.no_grad()
    def is_uncertain(self, id: int, rows: Int[Tensor, " M"]) -> Bool[Tensor, " M"]:
        """Which of some Gaussians are neither likely an object's nor surely anything else's."""
        _, classifier = require_identities(self.splats)
        limits = [MEMBER_SURE[each == BACKGROUND] if each != id else 1.0 for each in classifier.ids]
        limits = torch.tensor(limits).to(self.splats.means)
        parts = [(p <= limits).all(dim=1) for _, p in _probabilities(self.splats, rows)]
        return torch.cat(parts) & ~self.mask(id)[rows]


@torch.no_grad()
def label_members(splats: Splats, ids: Sequence[int], threshold: float) -> Members:
    """Find the Gaussians of some known label ids whose probability exceeds a threshold."""
    _, classifier = require_identities(splats)
    columns = torch.tensor([classifier.ids.index(id) for id in ids], device=splats.device)
    rows, numbers, confirmed = [], [], []
    every = torch.arange(len(splats), device=splats.device)
    for some, probabilities in _probabilities(splats, every):
        likely = probabilities.index_select(1, columns)
        row, number = (likely > threshold).nonzero(as_tuple=True)
        rows.append(some[row])
        numbers.append(number)
        confirmed.append(likely[row, number] > CONFIRMED)
    number = torch.cat(numbers)
    counts, order = torch.bincount(number, minlength=len(ids)).tolist(), number.argsort(stable=True)
    of_each, surely = (torch.cat(each)[order].split(counts) for each in (rows, confirmed))
    return Members(
        splats, dict(zip(ids, of_each, strict=True)), dict(zip(ids, surely, strict=True))
    )


def _probabilities(
    splats: Splats, rows: Int[Tensor, " M"]
) -> Iterator[tuple[Int[Tensor, " B"], Float[Tensor, "B K"]]]:
    """Some of the Gaussians at a time, and their probabilities of all classes."""
    identities, classifier = require_identities(splats)
    for some in rows.split(MEMBER_AT_ONCE):
        for part, scores in classifier.some_at_a_time(identities.index_select(0, some)):
            yield some[part], scores.softmax(dim=-1)


GAP_NEIGHBOURS = 16  # most of which are picked around a gap


@torch.no_grad()
def fill_gaps(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    doubtful: Callable[[Int[Tensor, " M"]], Bool[Tensor, " M"]],
) -> Bool[Tensor, " N"]:
    """Doubtful Gaussians most of whose neighbours are picked.

    Measured on the demo: they are 15 % of what shows of the vase, and 0.6 % of it lies beside it.
    """
    nobody = torch.zeros_like(picked)
    means, own = splats.means, picked.nonzero()[:, 0]
    if not (torch.sigmoid(splats.opacities[own]) >= EXTENT_FAINT).any():
        return nobody
    low, high = means[own].amin(dim=0), means[own].amax(dim=0)
    rows = overlapping(means, means, low, high)
    rows = rows[torch.sigmoid(splats.opacities[rows]) >= EXTENT_FAINT]
    others = rows[~picked[rows]]
    wanted = others[doubtful(others)]
    if not len(wanted):
        return nobody
    _, near = nearest_points(means[rows], means[wanted], GAP_NEIGHBOURS + 1)
    mostly = picked[rows[near[:, 1:]]].double().mean(dim=1) > 0.5  # the first is each itself
    return nobody.index_fill(0, wanted[mostly], True)


OUTLIER_NEIGHBOURS = 20  # a floating clump of a dozen Gaussians must not confirm itself
# Standard deviations. Measured on eight objects of two scenes: 2 takes away most of what floats
# for 1% of the object's own visible area at most (a thin plaque: 2%); 0.5 takes a fifth of it.
MEMBER_SPREAD = 2.0
MEMBER_FEWEST = 20  # fewer have no meaningful mean distance


def inliers(
    points: Float[Tensor, "N 3"],
    *,
    reaches: Float[Tensor, " N"] | None = None,
) -> Bool[Tensor, " N"]:
    """Which points lie about as close to their neighbours as the others do.

    A point is dropped when the logarithm of its mean distance to its nearest neighbours exceeds the
    mean of all points by `MEMBER_SPREAD` standard deviations. Densities in a splat span orders of
    magnitude; the logarithm makes them roughly normal and keeps a few distant floaters from
    inflating the deviation they are judged by. (PCL and Open3D use the plain distance.) Large
    Gaussians have far neighbours wherever they lie: `reaches` protects them.

    Args:
        points: Centres of one object's Gaussians.
        reaches: Mean distance to the neighbours up to which a point is kept in any case.

    Returns:
        True for the points to keep; sets of fewer than 20 are kept whole.
    """
    keep = torch.ones(len(points), dtype=torch.bool, device=points.device)
    if len(points) < MEMBER_FEWEST:
        return keep
    neighbours = min(OUTLIER_NEIGHBOURS, len(points) // 2)
    positions = points.detach().cpu()
    distances, _ = nearest_points(positions, positions, neighbours + 1)
    gaps = distances[:, 1:].mean(dim=1)  # column 0 is the point itself
    log_gaps = gaps.clamp(min=torch.finfo(torch.float32).tiny).log()
    usual = log_gaps <= log_gaps.mean() + MEMBER_SPREAD * log_gaps.std()
    if reaches is not None:
        usual |= gaps <= reaches.detach().cpu()
    return usual.to(points.device)


# Mean distance to neighbours over the standard deviation, up to which a Gaussian that label maps
# confirm is no outlier. Without this large ones are lost: 12 % of what shows of the lifted fox.
MEMBER_TOUCH = 4.0
UNKNOWN_SCENE = "SCENE"  # stands for an unknown folder of a scene


def pick(
    splats: Splats,
    *,
    object_id: int | Sequence[int] | None = None,
    box: ViewBox | None = None,
    point: Point | None = None,
    camera: Cameras | None = None,
    threshold: float = THRESHOLD,
    remove_outliers: bool = True,
) -> Bool[Tensor, " N"]:
    """Pick the Gaussians of one or more objects.

    Say which by exactly one of `object_id`, `box` and `point`.

    Args:
        splats: Gaussians with identities.
        object_id: Label id, or several, as the label maps name them.
        box: `(x0, y0, x1, y1)` in the photo's pixels; the object that shows most inside it.
        point: `(x, y)` in the photo's pixels; the object that shows there.
        camera: The view that `box` or `point` refers to, at the photo's full size.
        threshold: Probability of the object above which a Gaussian belongs to it; a Gaussian in
            doubt does if most of its neighbours do.
        remove_outliers: Whether to drop Gaussians that lie apart from the rest of the object,
            except large ones that touch their neighbours.

    Returns:
        True for the picked Gaussians.

    Raises:
        StyleSplatError: If the splats have no identities, no such object exists, the box or
            point is outside the image or shows no object, or no Gaussian passes `threshold`.
    """
    if not 0 <= threshold <= 1:
        raise StyleSplatError(f"A threshold of {threshold:g} is no probability. Give 0 to 1.")
    ids = resolve_ids(splats, object_id=object_id, box=box, point=point, camera=camera)
    picked = torch.zeros_like(splats.opacities, dtype=torch.bool)
    rules = {"threshold": threshold, "remove_outliers": remove_outliers}
    for id, mask in each_object(splats, ids, **rules):
        require_any(mask, id, threshold)
        picked |= mask
    return picked


def require_any(mask: Bool[Tensor, " N"], id: int, threshold: float = THRESHOLD) -> None:
    """Refuse an object without Gaussians."""
    if not mask.any():
        raise StyleSplatError(
            f"No Gaussian is object {id} with a probability above {threshold:g}. "
            "Lower the threshold, or train longer."
        )


def resolve_ids(
    splats: Splats,
    *,
    object_id: int | Sequence[int] | None = None,
    box: ViewBox | None = None,
    point: Point | None = None,
    camera: Cameras | None = None,
    folder: Path | None = None,
) -> tuple[int, ...]:
    """The label ids for the arguments of `pick`; `folder` is the scene's, for messages."""
    require_identities(splats)
    if sum(way is not None for way in (object_id, box, point)) != 1:
        raise StyleSplatError("Select by exactly one way: an id, a box or a point.")
    if object_id is not None:
        return _known_ids(splats, object_id, folder or UNKNOWN_SCENE)
    if camera is None or len(camera) != 1:
        raise StyleSplatError(
            "A box or point needs the one view it refers to. Pass camera=cameras[row]."
        )
    (name,) = camera.names
    if point is not None:
        check_point(point, camera.size, name)
        low, size = (int(point[0]), int(point[1])), (1, 1)
        what, where = "point", f"at {point[0]:g},{point[1]:g}"
    else:
        assert box is not None
        x0, y0, x1, y1 = check_box(box, camera.size, name)
        low = int(x0), int(y0)
        size = math.ceil(x1) - low[0], math.ceil(y1) - low[1]
        what, where = "box", f"inside box {','.join(f'{edge:g}' for edge in box)}"
    labels = render_labels(splats, camera.crop(low, size))
    ids, counts = labels[labels != BACKGROUND].unique(return_counts=True)
    if not len(ids):
        way = shell_command("objects", folder or UNKNOWN_SCENE)
        raise StyleSplatError(
            f"There is no object {where} in {name}. Choose another {what}, or run `{way}` and "
            "select by id."
        )
    return (int(ids[counts.argmax()]),)


def each_object(
    splats: Splats,
    ids: Sequence[int],
    *,
    threshold: float = THRESHOLD,
    remove_outliers: bool = True,
) -> Iterator[tuple[int, Bool[Tensor, " N"]]]:
    """Yields each label id with the Gaussians of its object, possibly none; see `pick`."""
    found = label_members(splats, ids, threshold)
    for id in dict.fromkeys(ids):
        mask = found.mask(id)
        if remove_outliers:
            rows, confirmed = found.likely[id], found.confirmed[id]
            reaches = MEMBER_TOUCH * splats.scales[rows].exp().amax(dim=1) * confirmed
            mask[rows] = inliers(splats.means[rows], reaches=reaches)
        mask |= fill_gaps(splats, mask, partial(found.is_uncertain, id))
        yield id, mask


def _known_ids(
    splats: Splats, object_id: int | Sequence[int], folder: Path | str
) -> tuple[int, ...]:
    ids = (object_id,) if isinstance(object_id, int) else tuple(object_id)
    known = object_ids(splats)
    if not ids:
        raise StyleSplatError("Select at least one object id; the list is empty.")
    names = ", ".join(map(str, known)) or "none"
    for id in ids:
        if id == BACKGROUND:
            way = shell_command("select", folder, "--name", "NAME", "--background")
            raise StyleSplatError(
                f"{id} is no object but the background. Name that with `{way}`. Objects: {names}."
            )
        if id not in known:
            raise StyleSplatError(f"Object {id} does not exist. Objects that do exist: {names}.")
    return ids
