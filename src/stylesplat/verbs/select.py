"""`select`: name some Gaussians of a scene."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.options import BOX, BOX3D, POINT, SPHERE, PickSize, Places, check_arguments
from stylesplat.progress import say
from stylesplat.scene.objects import check_name
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import IN_MEMORY, THRESHOLD, Selection
from stylesplat.selection.resolve import resolve_selection, whole_of


@check_arguments
def select(
    scene: Scene,
    name: str,
    *,
    id: int | Sequence[int] = (),
    box: Places = (),
    point: Places = (),
    not_point: Places = (),
    of: str | None = None,
    size: PickSize | None = None,
    text: str | Sequence[str] | None = None,
    box3d: Sequence[Any] = (),
    sphere: Places | None = None,
    rows: Path | str | Tensor | Sequence[Path | str] = (),
    plus: str | Sequence[str] = (),
    minus: str | Sequence[str] = (),
    all: bool = False,
    background: bool = False,
    grow: float | None = None,
    shrink: float | None = None,
    threshold: float = THRESHOLD,
    remove_outliers: bool = True,
    model: str | None = None,
    device: str = "auto",
) -> Scene:
    """Name an object by label id, places in photos, words, or a shape in the world.

    What is named is united. Pixels are those of the photos at full size; places in views are
    written as in `mask`, `(view, x, y)` or `(view, (x, y))`.

    Args:
        scene: Where it is.
        name: What to call it; an object of that name before is replaced.
        id: Label ids, as `objects` lists them.
        box: `(view, x0, y0, x1, y1)`, or several: the object that shows most inside.
        point: `(view, x, y)`, or several: the object that shows there.
        not_point: The same for objects that are not meant.
        of: The name of the object that this is a part of. What of the selection belongs to it
            becomes the part; the rest stays the object's. Points are on its surface.
        size: How much a point means in a scene without labels: `part`, `object` (the default
            there) or `group`, all that touches; in a scene with labels, instead of these. `part`
            is the default with `of`.
        text: A few words: the object that they mean, if it is clear which one. Or several texts.
        box3d: `(x0, y0, z0, x1, y1, z1)` in world units, or several: what lies inside, whatever
            it is.
        sphere: `(x, y, z, radius)` in world units; or `(view, x, y, radius)` around what shows at
            that pixel. Or several.
        rows: A file of row numbers, or several (see `read_rows`), of which a Gaussian of the base
            is selected if most of those that belong to it are; or such a mask; or one of the base.
        plus: Names of earlier selections that belong to it.
        minus: Names of earlier selections that do not.
        all: Everything.
        background: What is part of no label id's object; in a scene without label ids, of nothing
            else that has a name.
        grow: Take in what lies close by, as a share of the object's extent.
        shrink: Give up what lies close to anything else, likewise.
        threshold: Probability of the object above which a Gaussian belongs to it.
        remove_outliers: Whether to drop Gaussians that lie apart from the rest of an object.
        model: Folder or hub name of the model that finds the words.
        device: Where that model computes.

    Raises:
        StyleSplatError: If objects cannot be called that, the scene has no such object, the text
            means none or several, or nothing is left.

    Example:
        >>> scene = select(scene, "pot", point=("IMG_0007.jpg", 640, 420))  # doctest: +SKIP
    """
    check_name(name)
    if of == name:
        raise StyleSplatError(f"{name!r} is no part of itself. Give the part another name.")
    texts = _several(text or ())
    if model is not None and not texts:
        raise StyleSplatError("--model is for --text only. Pass --text, or leave out --model.")
    if grow is not None and shrink is not None:
        raise StyleSplatError("An object cannot grow and shrink. Pass --grow or --shrink.")
    mask = _base_mask(scene, rows) if isinstance(rows, Tensor) else None
    selection = Selection(
        ids=_several(id),
        boxes=BOX.parse_all(box, "box"),
        points=POINT.parse_all(point, "point"),
        not_points=POINT.parse_all(not_point, "not_point"),
        of=of,
        size=size,
        text=texts,
        model=model,
        box3d=tuple(corners for _, corners in BOX3D.parse_all(box3d, "box3d")),
        sphere=SPHERE.parse_all(sphere, "sphere"),
        rows=tuple(map(str, _several(rows))) if mask is None else IN_MEMORY,
        plus=_several(plus),
        minus=_several(minus),
        all=all,
        background=background,
        grow=grow,
        shrink=shrink,
        threshold=threshold,
        keep_outliers=not remove_outliers,
    )
    found = resolve_selection(scene, selection, name=name, mask=mask, device=device)
    if name in scene.objects:
        before = int(scene.objects[name].mask.sum())
        say(f"{name!r} meant {before:,} Gaussians before.")
    if of is not None:
        left = whole_of(scene, of, name) & ~found.mask
        scene = scene.with_object(of, replace(scene.objects[of], mask=left))
    return scene.with_object(name, found)


def _several(given: Any) -> tuple[Any, ...]:
    return (given,) if isinstance(given, int | str | Path) else tuple(given)


def _base_mask(scene: Scene, rows: Tensor) -> Tensor:
    """A mask of the base, of one of it or of all Gaussians."""
    count = len(scene.splats)
    if rows.dtype != torch.bool or rows.shape not in ((count,), (len(scene.base),)):
        raise StyleSplatError(
            f"Cannot select by rows of {rows.dtype} and shape {tuple(rows.shape)}. Give a mask "
            f"of {count:,} Gaussians."
        )
    return rows if len(rows) == len(scene.base) else scene.most_of(rows)
