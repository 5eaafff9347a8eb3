"""Paintings taken back: all of a scene's, or some, the others staying as they are."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.paintings import Gone, Looks, Painted, Painting, Unsplit
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.stylization.bookkeeping import chosen, require_painted, taken_rows


def require_painted_objects(scene: Scene, names: Collection[str]) -> Painted:
    """What was painted on a scene, among it some objects.

    Raises:
        StyleSplatError: If nothing was, or one of them was not.
    """
    painted = require_painted(scene)
    unknown = next((name for name in names if name not in painted.names), None)
    if unknown is not None:
        raise StyleSplatError(
            f"{unknown} is not styled in {scene.path or 'this scene'}. "
            f"Styled objects: {', '.join(painted.names)}."
        )
    return painted


def unpainted(scene: Scene, names: Collection[str] | None = None) -> Scene:
    """A styled scene as it was before some objects were painted, to the bit.

    These objects' Gaussians have their colours again, and those that were split for them their
    shapes; what the splits made of them goes, so that the others' additional Gaussians move up.
    Of objects that were named since, what was there before stays.

    Args:
        scene: With something painted.
        names: The objects as they were called when they were painted; all by default.

    Raises:
        StyleSplatError: If nothing was painted, or one of the objects was not.
    """
    if names is not None and not names:
        return scene
    painted = require_painted_objects(scene, names or ())
    left = [p for p in painted.paintings if names is not None and p.name not in names]
    taken = [p.picked for p in painted.paintings if names is None or p.name in names]
    # All of them, whatever is known of each: scenes of old knew less
    mine = torch.stack(taken).any(dim=0) if left else torch.ones(len(scene.splats)).bool()
    colored = chosen(mine, painted.before, Looks.of(scene.splats)).on(scene.splats)
    rows = _kept_rows(mine, painted.unsplit)
    objects = {
        name: taken_rows(each, rows)
        for name, each in scene.objects.items()
        if each.picked[rows].any() or not each.picked.any()  # not of what goes alone
    }
    metrics = scene.metrics.get("train", {})
    splats = _of_rows(_unsplit(colored, mine, painted.unsplit), rows)
    return replace(
        scene,
        splats=splats,
        objects=objects,
        painted=_painted_still(painted, left, mine, rows, splats) if left else None,
        path=None,
        metrics={"train": metrics} if left else metrics,
    )


def _kept_rows(mine: Bool[Tensor, " N"], unsplit: Unsplit | None) -> Int[Tensor, " M"]:
    """All but what splits made of some Gaussians."""
    kept = torch.ones_like(mine)
    if unsplit is not None:
        kept[unsplit.count :] = ~mine[unsplit.count :]
    return kept.nonzero()[:, 0]


def _of_rows(splats: Splats, rows: Int[Tensor, " M"]) -> Splats:
    """The same of some rows in order; if they are the first ones it takes no memory."""
    first = not len(rows) or int(rows[-1]) == len(rows) - 1
    return splats[: len(rows)] if first else splats[rows]


def _unsplit(splats: Splats, mine: Bool[Tensor, " N"], unsplit: Unsplit | None) -> Splats:
    """The splats, some of them in their shapes before they were split."""
    if unsplit is None:
        return splats
    chosen_rows = mine[unsplit.rows]
    rows = unsplit.rows[chosen_rows]
    shapes = {name: getattr(unsplit, name)[chosen_rows] for name in ("scales", "opacities")}
    return splats.with_rows(rows, shapes)


def _painted_still(
    painted: Painted,
    left: Sequence[Painting],
    mine: Bool[Tensor, " N"],
    rows: Int[Tensor, " M"],
    splats: Splats,
) -> Painted:
    """What is known of the paintings that are left."""

    def whole_again(looks: Looks) -> Looks:
        """Those that were split for what is gone have their opacities again, as in the splats."""
        opacities = torch.where(mine[rows], splats.opacities, looks.opacities[rows])
        return replace(looks[rows], opacities=opacities)

    return Painted(
        paintings=tuple(replace(each, picked=each.picked[rows]) for each in left),
        before=whole_again(painted.before),
        full=whole_again(chosen(mine, painted.before, painted.full)),
        unsplit=_still_split(painted.unsplit, mine, len(rows)),
        origin=painted.origin,
        gone=_gone(painted, {each.name for each in left}),
    )


def _still_split(unsplit: Unsplit | None, mine: Bool[Tensor, " N"], left: int) -> Unsplit | None:
    """How to undo the splits of all others, so many Gaussians being left in all."""
    if unsplit is None:
        return None
    others = ~mine[unsplit.rows]
    if not others.any() and left == unsplit.count:
        return None
    return Unsplit(
        count=unsplit.count,
        rows=unsplit.rows[others],
        scales=unsplit.scales[others],
        opacities=unsplit.opacities[others],
    )


def _gone(painted: Painted, left: Collection[str]) -> tuple[Gone, ...]:
    """What is not there, but was when something that is needed was painted upon it."""
    needed: set[str] = set()
    found, place = [], len(left)
    for painting, is_there in reversed(painted.history):
        stays = is_there and painting.name in left
        place -= stays
        if not stays and painting.name in needed:
            found.append(Gone(replace(painting, picked=painting.picked[:0]), place))
        elif not stays:
            continue
        needed = (needed - {painting.name}) | painting.upon.keys()
    return tuple(reversed(found))
