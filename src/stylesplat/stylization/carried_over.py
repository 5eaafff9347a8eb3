"""A splat that was edited elsewhere, with the objects and paintings of the scene it came from."""

from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_ply import of_degree
from stylesplat.progress import say
from stylesplat.scene.frames import SAME, seen_from
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.paintings import Looks, Painted
from stylesplat.scene.same_gaussians import Match, match_gaussians
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import Splats
from stylesplat.scene.turned import moved

EDITED = 0.1  # of a constant band: colours that differ by more, at the median, were edited
DEGREE = 3  # of the splats of scenes


def carried_over(splats: Splats, scene: Scene, *, name: str = "The splat") -> Scene:
    """The scene with a splat in place of its own that other programs made of that.

    Gaussians are found again whatever their order, and if the whole or parts of it were moved (see
    `match_gaussians`). They keep their objects and, if their colours were not edited, can be taken
    back to what they were before they were painted. New ones belong to nothing. The views go
    where most Gaussians went.

    Args:
        splats: The splat.
        scene: What it was made of.
        name: What to call the splat.

    Returns:
        The scene. Its metrics are `gaussians`, `matched`, `new_gaussians`, `lost_gaussians` and
        `moved`: of each part that was moved the number of `gaussians`, its `scale` and how many
        `degrees` it was turned.

    Raises:
        StyleSplatError: If none of its Gaussians is one of the scene's.
    """
    splats = of_degree(splats.to("cpu"), DEGREE)
    match = match_gaussians(splats, scene.splats)
    if not match.parts:
        raise StyleSplatError(
            f"{name} shows nothing of {scene.path or 'the scene'}: none of its {len(splats):,} "
            "Gaussians is one of these. Name the scene that it came from, or import it without one."
        )
    rows, here = match.rows.clamp(min=0), match.rows >= 0
    frame = match.parts[0][0]
    painted = scene.painted and _painted(scene, scene.painted, splats, match)
    found = replace(
        scene,
        splats=_identified(splats, scene.splats, rows, here),
        cameras=scene.cameras if frame is SAME else seen_from(scene.cameras, frame),
        objects=_objects(scene, rows, here),
        painted=painted,
        path=None,
    )
    return replace(found, metrics=_told(match, len(scene.splats)))


def _identified(
    splats: Splats, known: Splats, rows: Int[Tensor, " M"], here: Bool[Tensor, " M"]
) -> Splats:
    """The splats with the identities of the known ones, and with nobody's where there is none."""
    if known.identities is None or known.classifier is None:
        return splats
    nobody = known.identities.new_zeros(known.identities.shape[1])
    if BACKGROUND in known.classifier.ids:
        column = known.classifier.ids.index(BACKGROUND)
        scores = known.classifier.some_at_a_time(known.identities)
        shares = torch.cat([each.softmax(dim=-1)[:, column] for _, each in scores])
        nobody = known.identities[shares.argmax()]
    confidence = known.confidence
    return replace(
        splats,
        identities=torch.where(here[:, None], known.identities[rows], nobody),
        classifier=known.classifier,
        confidence=None if confidence is None else torch.where(here, confidence[rows], 0.0),
    )


def _objects(
    scene: Scene, rows: Int[Tensor, " M"], here: Bool[Tensor, " M"]
) -> dict[str, SceneObject]:
    """Those of which something is left; the user is told of what is not."""
    objects = dict[str, SceneObject]()
    for name, each in scene.objects.items():
        picked = each.picked[rows] & here
        count, before = int(picked.sum()), int(each.picked.sum())
        if count < before:
            left = f"{count:,} of its {before:,} Gaussians are" if count else "nothing is"
            say(f"{name}: {left} left.")
        if count:
            objects[name] = SceneObject(picked, {**each.how, "gaussians": count})
    return objects


def _painted(scene: Scene, painted: Painted, splats: Splats, match: Match) -> Painted | None:
    """What was painted on the Gaussians that are left, if they still look so."""
    rows, here = match.rows.clamp(min=0), match.rows >= 0
    paintings = tuple(replace(each, picked=each.picked[rows] & here) for each in painted.paintings)
    paintings = tuple(each for each in paintings if each.picked.any())
    if not paintings:
        return None
    mine = torch.stack([each.picked for each in paintings]).any(dim=0)
    change = (splats.sh0[mine] - scene.splats.sh0[rows[mine]]).abs().median()
    if change > EDITED:
        say(
            "The colours of what is painted were edited: its paintings are not carried over, they "
            "stay as they look."
        )
        return None
    return replace(
        painted,
        paintings=paintings,
        before=_looks(painted.before.on(scene.splats), splats, match),
        full=_looks(painted.full.on(scene.splats), splats, match),
        unsplit=None,
    )


def _looks(known: Splats, splats: Splats, match: Match) -> Looks:
    """How the known Gaussians look, turned along with what they became; the splat's own else."""
    looks = {name: each.clone() for name, each in vars(Looks.of(splats)).items()}
    for frame, mask in match.parts:
        part = Looks.of(of_degree(moved(known[match.rows[mask]], frame), DEGREE))
        for name, each in vars(part).items():
            looks[name][mask] = each
    return Looks(**looks)


def _told(match: Match, before: int) -> dict[str, Any]:
    matched, count = int((match.rows >= 0).sum()), len(match.rows)
    moves = [
        {
            "gaussians": int(mask.sum()),
            "scale": round(frame.scale, 6),
            "degrees": round(_degrees(frame.rotation), 3),
        }
        for frame, mask in match.parts
        if frame is not SAME
    ]
    counts = {"gaussians": count, "matched": matched, "new_gaussians": count - matched}
    return {**counts, "lost_gaussians": before - matched, "moved": moves}


def _degrees(rotation: Float[Tensor, "3 3"]) -> float:
    """How far a rotation turns."""
    cosine = (rotation.diagonal().sum() - 1) / 2
    return float(torch.rad2deg(cosine.clamp(-1, 1).arccos()))
