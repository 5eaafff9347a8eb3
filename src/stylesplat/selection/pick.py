"""An object's Gaussians by label id, by a box or by a point: on bare splats."""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.arguments import check_box, check_point, pasted
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.projection import crop
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import object_ids, render_labels, require_identities
from stylesplat.selection.members import fill_gaps, inliers, members

THRESHOLD = 0.5  # a Gaussian is picked when its object is likelier than all others together
# Mean distance to neighbours over the standard deviation, up to which a Gaussian that label maps
# confirm is no outlier. Without this large ones are lost: 12 % of what shows of the lifted fox.
TOUCH = 4.0
SCENE = "SCENE"  # stands for an unknown folder of a scene

Point = tuple[float, float]
Box = tuple[float, float, float, float]


def pick(
    splats: Splats,
    *,
    object_id: int | Sequence[int] | None = None,
    box: Box | None = None,
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
    box: Box | None = None,
    point: Point | None = None,
    camera: Cameras | None = None,
    folder: Path | None = None,
) -> tuple[int, ...]:
    """The label ids for the arguments of `pick`; `folder` is the scene's, for messages."""
    require_identities(splats)
    if sum(way is not None for way in (object_id, box, point)) != 1:
        raise StyleSplatError("Select by exactly one way: an id, a box or a point.")
    if object_id is not None:
        return _known_ids(splats, object_id, folder or SCENE)
    if camera is None or len(camera) != 1:
        raise StyleSplatError(
            "A box or point needs the one view it refers to. Pass camera=cameras[row]."
        )
    if point is not None:
        return (_id_at_point(splats, point, camera, folder or SCENE),)
    assert box is not None
    return (_id_in_box(splats, box, camera, folder or SCENE),)


def each_object(
    splats: Splats,
    ids: Sequence[int],
    *,
    threshold: float = THRESHOLD,
    remove_outliers: bool = True,
) -> Iterator[tuple[int, Bool[Tensor, " N"]]]:
    """Yields each label id with the Gaussians of its object, possibly none; see `pick`."""
    found = members(splats, ids, threshold)
    for id in dict.fromkeys(ids):
        mask = found.mask(id)
        if remove_outliers:
            rows, confirmed = found.likely[id], found.confirmed[id]
            reaches = TOUCH * splats.scales[rows].exp().amax(dim=1) * confirmed
            mask[rows] = inliers(splats.means[rows], reaches=reaches)
        mask |= fill_gaps(splats, mask, partial(found.doubtful, id))
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
            way = pasted("select", folder, "--name", "NAME", "--background")
            raise StyleSplatError(
                f"{id} is no object but the background. Name that with `{way}`. Objects: {names}."
            )
        if id not in known:
            raise StyleSplatError(f"Object {id} does not exist. Objects that do exist: {names}.")
    return ids


def _id_at_point(splats: Splats, point: Point, camera: Cameras, folder: Path | str) -> int:
    check_point(point, camera.size, camera.names[0])
    x, y = point
    label = int(render_labels(splats, crop(camera, (int(x), int(y)), (1, 1))))
    if label == BACKGROUND:
        raise StyleSplatError(
            f"There is no object at {x:g},{y:g} in {camera.names[0]}. "
            f"Choose another point, or run `{pasted('objects', folder)}` and select by id."
        )
    return label


def _id_in_box(splats: Splats, box: Box, camera: Cameras, folder: Path | str) -> int:
    x0, y0, x1, y1 = check_box(box, camera.size, camera.names[0])
    low, high = (int(x0), int(y0)), (math.ceil(x1), math.ceil(y1))
    labels = render_labels(splats, crop(camera, low, (high[0] - low[0], high[1] - low[1])))
    ids, counts = labels[labels != BACKGROUND].unique(return_counts=True)
    if not len(ids):
        text = ",".join(f"{edge:g}" for edge in box)
        raise StyleSplatError(
            f"There is no object inside box {text} in {camera.names[0]}. "
            f"Choose another box, or run `{pasted('objects', folder)}` and select by id."
        )
    return int(ids[counts.argmax()])
