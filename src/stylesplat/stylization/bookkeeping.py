"""What a scene remembers of its paintings: added, made stronger or weaker."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.paintings import Looks, Painted, Painting, Unsplit
from stylesplat.scene.pasted import pasted
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import Splats
from stylesplat.stylization.crossfade import crossfade
from stylesplat.stylization.styled_scene import Styled


def require_painted(scene: Scene) -> Painted:
    """What was painted on a scene.

    Raises:
        StyleSplatError: If nothing was.
    """
    if scene.painted is None:
        options = ("--style", "OBJECT=IMAGE", "-o", "STYLED")
        way = pasted("stylize", scene.path or "SCENE", *options)
        raise StyleSplatError(
            f"{scene.path or 'The scene'} is not styled. Style it first: `{way}`."
        )
    return scene.painted


def refuse_painted(scene: Scene, picks: Mapping[str, Bool[Tensor, " N"]]) -> None:
    """Check that objects may be painted: what they looked like before is kept once.

    Raises:
        StyleSplatError: If Gaussians of one are part of something else that is painted.
    """
    if scene.painted is None:
        return
    for name, picked in picks.items():
        for painting in scene.painted.paintings:
            if (painting.picked & picked.to("cpu")).any():
                options = ("--object", painting.name, "--undo", "-o", "SCENE")
                way = pasted("adjust", scene.path or "STYLED", *options)
                raise StyleSplatError(
                    f"{name} is styled in {scene.path or 'the scene'} already, as a part of "
                    f"{painting.name}. Take that back first: `{way}`."
                )


def strengths(scene: Scene) -> dict[str, float]:
    """How strong each painting of a scene is, by name."""
    return {p.name: p.intensity for p in scene.painted.paintings} if scene.painted else {}


def with_paintings(scene: Scene, styled: Styled, paintings: Sequence[Painting]) -> Scene:
    """The scene with what was painted on it, and all that undoes that.

    Args:
        scene: As it was painted upon.
        styled: Its Gaussians after; those that are new follow all others.
        paintings: What is new, its Gaussians being those of `scene`.
    """
    parents, known = styled.parents.cpu(), scene.painted
    mine = torch.stack([painting.picked for painting in paintings]).any(dim=0)[parents]
    splats, base = styled.splats.to("cpu"), styled.base.to("cpu")
    before, full = Looks.of(base), Looks.of(styled.full.to("cpu"))
    if known is not None:
        before = chosen(mine, before, known.before[parents])
        full = chosen(mine, full, known.full[parents])
    every = (*(known.paintings if known else ()), *paintings)
    painted = Painted(
        paintings=tuple(replace(each, picked=each.picked[parents]) for each in every),
        before=before,
        full=full,
        unsplit=_unsplit(scene, base),
        origin=known.origin if known else None,
        gone=known.gone if known else (),
    )
    objects = {name: taken_rows(each, parents) for name, each in scene.objects.items()}
    return replace(scene, splats=splats, objects=objects, painted=painted, path=None)


def with_origin(scene: Scene, before: Scene) -> Scene:
    """A styled scene that knows which one it was made of, whatever became of it in between."""
    origin = before.painted.origin if before.painted else _absolute(before.path)
    return replace(scene, painted=replace(require_painted(scene), origin=origin))


def at_intensities(scene: Scene, intensities: Mapping[str, float]) -> Scene:
    """A styled scene whose paintings are stronger or weaker.

    Args:
        scene: With something painted.
        intensities: By name; paintings that are not named stay as they are.
    """
    painted = require_painted(scene)
    splats, paintings, parts = scene.splats, [], list[tuple[Tensor, Looks]]()
    for each in painted.paintings:
        wanted = intensities.get(each.name, each.intensity)
        if wanted != each.intensity:
            rows = each.picked.to(splats.device).nonzero()[:, 0]
            parts.append((rows, _mixed(painted, splats[rows], rows, wanted)))
        paintings.append(replace(each, intensity=wanted))
    painted = replace(painted, paintings=tuple(paintings))
    return replace(scene, splats=_looking(splats, parts), painted=painted, path=None)


def _mixed(painted: Painted, splats: Splats, rows: Int[Tensor, " R"], intensity: float) -> Looks:
    """The looks of some Gaussians of a painting at another intensity."""
    everyone = torch.ones(len(rows), dtype=torch.bool, device=rows.device)
    base, full = painted.before[rows].on(splats), painted.full[rows].on(splats)
    return Looks.of(crossfade(base, full, everyone, intensity))


def _looking(splats: Splats, parts: Sequence[tuple[Int[Tensor, " _"], Looks]]) -> Splats:
    """The splats with other looks of some Gaussians."""
    if not parts:
        return splats
    rows = torch.cat([rows for rows, _ in parts])
    looks = [vars(look) for _, look in parts]
    names = looks[0].keys()
    return splats.with_rows(rows, {n: torch.cat([each[n] for each in looks]) for n in names})


def taken_rows(each: SceneObject, rows: Int[Tensor, " M"]) -> SceneObject:
    """An object among the Gaussians of some rows."""
    picked = each.picked[rows]
    count = {"gaussians": int(picked.sum())} if "gaussians" in each.how else {}
    return SceneObject(picked, {**each.how, **count})


def chosen(mine: Bool[Tensor, " N"], one: Looks, other: Looks) -> Looks:
    """One's looks of some Gaussians, and other ones of the rest; of all they take no memory."""
    if mine.all():
        return one
    mask = mine[:, None, None]
    return Looks(
        sh0=torch.where(mask, one.sh0, other.sh0),
        shN=torch.where(mask, one.shN, other.shN),
        opacities=torch.where(mine, one.opacities, other.opacities),
    )


def _absolute(path: Path | None) -> Path | None:
    return path and path.resolve()


def _unsplit(scene: Scene, base: Splats) -> Unsplit | None:
    """How to undo this split, and those before it."""
    before, known = scene.splats, scene.painted.unsplit if scene.painted else None
    count = known.count if known else len(before)
    changed = (base.scales[:count] != before.scales[:count]).any(dim=1)
    changed |= base.opacities[:count] != before.opacities[:count]
    if known is not None:
        changed[known.rows] = False  # their shapes before are kept already
    if known is None and not changed.any() and len(base) == count:
        return None
    rows = changed.nonzero()[:, 0]
    found = Unsplit(count, rows, before.scales[rows], before.opacities[rows])
    if known is None:
        return found
    return Unsplit(
        count,
        torch.cat([known.rows, found.rows]),
        torch.cat([known.scales, found.scales]),
        torch.cat([known.opacities, found.opacities]),
    )
