"""A splat that was edited elsewhere, with the objects and paintings of the scene it came from."""

from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_ply import of_degree
from stylesplat.progress import say
from stylesplat.scene.compose import compose, mask_of, spans, taken_rows
from stylesplat.scene.frames import SAME, move_splats, seen_from
from stylesplat.scene.labels import BACKGROUND
from stylesplat.scene.layer import Layer, taken
from stylesplat.scene.same_gaussians import Match, match_gaussians
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import Splats

EDITED = 0.1  # of a constant band: colours that differ by more, at the median, were edited
DEGREE = 3  # of the splats of scenes
LOOKS = ("sh0", "shN", "opacities")


def carried_over(splats: Splats, scene: Scene, *, name: str = "The splat") -> Scene:
    """The scene with a splat in place of its own that other programs made of that.

    Gaussians are found again whatever their order, and if the whole or parts of it were moved (see
    `match_gaussians`). They keep their objects and, if their colours were not edited, their layers
    of paint, whose canvases come after all else. New ones belong to nothing. The views go where
    most Gaussians went.

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
    found = replace(
        scene,
        splats=_identified(splats, scene.splats, rows, here),
        base=None,
        layers=(),
        cameras=scene.cameras if frame is SAME else seen_from(scene.cameras, frame),
        objects=_objects(scene, rows, here),
        path=None,
    )
    if scene.layers and not _edited(scene, splats, match):
        found = _with_layers_of(scene, found, match)
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


def _edited(scene: Scene, splats: Splats, match: Match) -> bool:
    """Whether what is painted looks otherwise; if so, the user is told."""
    painted = torch.stack([mask_of(layer, scene) for layer in scene.layers]).any(dim=0)
    mine = (match.rows >= 0) & painted[match.rows.clamp(min=0)]
    if not mine.any():
        return True
    change = (splats.sh0[mine] - scene.splats.sh0[match.rows[mine]]).abs().median()
    if change > EDITED:
        say(
            "The colours of what is painted were edited: its paintings are not carried over, they "
            "stay as they look."
        )
    return bool(change > EDITED)


def _with_layers_of(scene: Scene, found: Scene, match: Match) -> Scene:
    """The found scene with the layers of the known one; canvases come after all else."""
    known, here = scene.unpainted, match.rows >= 0
    mine = (~here | (match.rows < len(known))).nonzero()[:, 0]
    rows = match.rows[mine]
    places = torch.full((len(known),), -1)
    places[rows[rows >= 0]] = (rows >= 0).nonzero()[:, 0]
    covered = torch.zeros(len(known), dtype=torch.bool)
    base, layers, order = found.splats[mine], list[Layer](), [mine]
    canvases = {id(layer): (first, end) for layer, first, end in spans(scene)}
    for layer in scene.layers:
        covered[layer.rows] = True
        first, end = canvases.get(id(layer), (0, 0))
        new = ((match.rows >= first) & (match.rows < end)).nonzero()[:, 0]
        left = match.rows[new] - first if layer.is_shown else None
        part = taken(_turned(layer, known, places, mine, match), places, left)
        if not (len(part.rows) or len(part.parents)):
            continue
        if layer.is_shown:
            order.append(new)
            shapes = {n: getattr(found.splats, n)[new] for n in ("means", "quats", "scales")}
            part = replace(part, canvas=replace(part.canvas, **shapes))
        layers.append(part)
    for frame, mask in match.parts:
        looks = (mask[mine] & covered[rows.clamp(min=0)]).nonzero()[:, 0]
        looks = looks[rows[looks] >= 0]
        before = of_degree(move_splats(known[rows[looks]], frame), DEGREE)
        base = base.with_rows(looks, {n: getattr(before, n) for n in LOOKS})
    objects = {name: taken_rows(each, torch.cat(order)) for name, each in found.objects.items()}
    if not layers:
        return found
    splats = compose(base, layers)
    return replace(found, splats=splats, base=base, layers=tuple(layers), objects=objects)


def _turned(layer: Layer, base: Splats, places: Tensor, mine: Tensor, match: Match) -> Layer:
    """A layer whose higher bands turned along with the Gaussians that it covers.

    Its canvas moved as most did.
    """
    paint = of_degree(replace(base[layer.rows], sh0=layer.sh0, shN=layer.shN), DEGREE)
    shN = paint.shN.clone()
    gone = places[layer.rows] < 0
    there = mine[places[layer.rows].clamp(min=0)]
    for frame, mask in match.parts:
        part = (mask[there] & ~gone).nonzero()[:, 0]
        shN[part] = move_splats(paint[part], frame).shN
    canvas = move_splats(of_degree(layer.canvas, DEGREE), match.parts[0][0])
    return replace(layer, shN=shN, canvas=canvas)


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
