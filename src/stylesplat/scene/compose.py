"""A base and a stack of layers composed to one splat."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.scene.arguments import pasted
from stylesplat.scene.layer import Layer
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import SH_C0, Splats

UNSEEN = -16.0  # logit of an opacity that no picture shows
THROUGH = 0.003  # of what lies beneath, by a whole canvas: strengths show as they are called


def compose(base: Splats, layers: Sequence[Layer]) -> Splats:
    """The base with layers upon it, the lowest first.

    Colours of the covered rows go towards the layer's by strength times share; beyond 1 they go
    farther. Renders are linear in the colours, so that composing these blends the renders, wherever
    no colour is clamped. A canvas carries its paint from the first. It fades in over what it hides,
    which fades once half of the canvas is there.

    Args:
        base: The unpainted splat.
        layers: The stack. Layers that are hidden or of strength 0 change nothing, to the bit.

    Returns:
        The rows of the base, then the canvases in the order of the stack.
    """
    splats, family = base, torch.arange(len(base), device=base.device)
    for layer in layers:
        if layer.is_shown:
            splats = _appended(_covered(splats, family, layer, len(base)), base, layer)
            family = torch.cat([family, layer.parents])
    return splats


def family_of(base: Splats, layers: Sequence[Layer]) -> Int[Tensor, " M"]:
    """The row of the base that each row of the composed splats belongs to."""
    shown = [layer.parents for layer in layers if layer.is_shown]
    return torch.cat([torch.arange(len(base), device=base.device), *shown])


def family(scene: Scene) -> Int[Tensor, " M"]:
    """As `family_of`, of a scene."""
    return family_of(scene.unpainted, scene.layers)


def with_layers(scene: Scene, layers: Sequence[Layer]) -> Scene:
    """The scene with another stack of layers; what objects mean follows.

    Gaussians of a canvas that is there before and after keep their objects; those of a new canvas
    belong to the objects of their parents. Objects that lose all of their Gaussians go.
    """
    base = scene.unpainted
    rows = _rows_before(scene, layers)
    objects = {name: taken_rows(each, rows) for name, each in scene.objects.items()}
    kept = {
        name: each
        for name, each in objects.items()
        if each.picked.any() or not scene.objects[name].picked.any()
    }
    return replace(
        scene,
        splats=compose(base, layers),
        base=base if layers else None,
        layers=tuple(layers),
        objects=kept,
        path=None,
    )


def beneath(scene: Scene, name: str) -> tuple[Scene, int]:
    """What the paint of an object lies on, or would, and the place of its layer in the stack."""
    place = next((n for n, each in enumerate(scene.layers) if each.object == name), None)
    if place is None:
        return scene, len(scene.layers)
    return replace(with_layers(scene, scene.layers[:place]), path=scene.path), place


def without_layers(scene: Scene, names: Collection[str] | None = None) -> Scene:
    """The scene as it was before some objects were painted.

    Args:
        scene: A painted scene.
        names: The objects, as their layers call them; by default all.

    Raises:
        StyleSplatError: If nothing is painted, or one of the objects is not.
    """
    if names is not None and not names:
        return scene
    require_painted(scene, names or ())
    left = [each for each in scene.layers if names is not None and each.object not in names]
    metrics = scene.metrics.get("train", {})
    return replace(with_layers(scene, left), metrics={"train": metrics} if left else metrics)


def with_strengths(
    scene: Scene, strengths: Mapping[str, float], forms: Mapping[str, float] | None = None
) -> Scene:
    """A scene whose layers are stronger or weaker, or show more or less form.

    Args:
        scene: With layers.
        strengths: By the names of the objects; other layers stay as they are.
        forms: Likewise.
    """
    changed = dict[int, Layer]()
    for place, each in enumerate(scene.layers):
        strength = strengths.get(each.object, each.strength)
        form = (forms or {}).get(each.object, each.form)
        if (strength, form) != (each.strength, each.form):
            changed[place] = replace(each, strength=strength, form=form)
    layers = [changed.get(place, each) for place, each in enumerate(scene.layers)]
    return with_layers(scene, layers) if changed else scene


def strengths_of(scene: Scene) -> dict[str, float]:
    """How strong each layer of a scene is, by the name of its object."""
    return {each.object: each.strength for each in scene.layers}


def require_painted(scene: Scene, names: Collection[str] = ()) -> None:
    """Check that a scene is painted, and among others some objects.

    Raises:
        StyleSplatError: If it is not, or one of them is not.
    """
    if not scene.layers:
        way = pasted("stylize", scene.path or "SCENE", "--style", "OBJECT=IMAGE", "-o", "STYLED")
        raise StyleSplatError(
            f"{scene.path or 'The scene'} is not styled. Style it first: `{way}`."
        )
    unknown = next((name for name in names if name not in scene.painted_objects), None)
    if unknown is not None:
        raise StyleSplatError(
            f"{unknown} is not styled in {scene.path or 'this scene'}. "
            f"Styled objects: {', '.join(scene.painted_objects)}."
        )


def mask_of(layer: Layer, scene: Scene) -> Bool[Tensor, " M"]:
    """The Gaussians of a scene that belong to what a layer covers."""
    own = torch.zeros(len(scene.unpainted), dtype=torch.bool)
    own[layer.rows] = True
    return own[family(scene)]


def spans(scene: Scene) -> list[tuple[Layer, int, int]]:
    """The layers that show, and where their canvases begin and end among the splats."""
    shown = [layer for layer in scene.layers if layer.is_shown]
    ends = [*accumulate((len(layer.parents) for layer in shown), initial=len(scene.unpainted))]
    return [*zip(shown, ends, ends[1:], strict=False)]


def new_ones_last(scene: Scene, names: Collection[str]) -> tuple[Splats, Int[Tensor, " M"]]:
    """The splats of a scene with the canvases of some layers after all else, and their families."""
    parts = sorted(spans(scene), key=lambda part: part[0].object in names)
    order = [torch.arange(first, end) for _, first, end in parts]
    rows = torch.cat([torch.arange(len(scene.unpainted)), *order])
    return scene.splats[rows], family(scene)[rows]


def rows_unpainted(scene: Scene) -> Splats:
    """All Gaussians of a scene as they are without paint: those of canvases do not show."""
    base, count = scene.unpainted, len(scene.unpainted)
    unseen = scene.splats[count:]
    unseen = replace(unseen, opacities=torch.full_like(unseen.opacities, UNSEEN))
    return Splats.cat([base, unseen])


def taken_rows(each: SceneObject, rows: Int[Tensor, " M"]) -> SceneObject:
    """An object among the Gaussians of some rows."""
    picked = each.picked[rows]
    count = {"gaussians": int(picked.sum())} if "gaussians" in each.how else {}
    return SceneObject(picked, {**each.how, **count})


def _rows_before(scene: Scene, layers: Sequence[Layer]) -> Int[Tensor, " M"]:
    """The row of a scene that each row takes after once it has other layers."""
    starts = {id(layer.parents): first for layer, first, _ in spans(scene)}
    parts = [torch.arange(len(scene.unpainted))]
    for layer in layers:
        if layer.is_shown:
            first = starts.get(id(layer.parents))
            own = torch.arange(len(layer.parents))
            parts.append(layer.parents if first is None else first + own)
    return torch.cat(parts)


def _covered(splats: Splats, family: Int[Tensor, " M"], layer: Layer, count: int) -> Splats:
    """What lies beneath a layer, with its paint."""
    entry = family.new_full((count,), -1)
    entry[layer.rows] = torch.arange(len(layer.rows), device=family.device)
    entries = entry[family]
    rows = (entries >= 0).nonzero()[:, 0]
    entries = entries[rows]
    weights = (layer.strength * layer.shares)[entries, None, None]
    paint = layer.sh0 + _form(layer)[: len(layer.rows), None, None]
    factors = layer.opacity_factors[entries]
    return splats.with_rows(
        rows,
        {
            "sh0": torch.lerp(splats.sh0[rows], paint[entries], weights),
            "shN": torch.lerp(splats.shN[rows], layer.shN[entries], weights),
            "opacities": _faded(splats.opacities[rows], factors, layer.strength),
        },
    )


def _appended(splats: Splats, base: Splats, layer: Layer) -> Splats:
    """The splats and the canvas of a layer."""
    canvas, parents = layer.canvas, layer.parents
    if not len(canvas):
        return splats
    farther = max(layer.strength, 1.0)
    paint = canvas.sh0 + _form(layer)[len(layer.rows) :, None, None]
    canvas = replace(
        canvas,
        sh0=torch.lerp(layer.canvas_sh0, paint, torch.full_like(paint, farther)),
        shN=canvas.shN * farther,
        opacities=_appeared(canvas.opacities, layer.strength),
        identities=None if base.identities is None else base.identities[parents],
        confidence=None if base.confidence is None else base.confidence[parents],
    )
    return Splats.cat([splats, canvas])


def _form(layer: Layer) -> Float[Tensor, " L"]:
    """What the constant band gets of the relief, besides what the paint has already."""
    return layer.relief * ((layer.form - layer.painted_form) / SH_C0)


def _faded(
    opacities: Float[Tensor, " R"], factors: Float[Tensor, " R"], strength: float
) -> Float[Tensor, " R"]:
    """Opacities of what a layer hides; to the bit where nothing fades."""
    share = max(0.0, 2 * min(strength, 1.0) - 1)
    hidden = torch.sigmoid(opacities.double()) * factors
    # Logarithms of what is let through: those of floats differ in their last bit by the place
    start, end = -F.softplus(opacities.double()), torch.log1p(-hidden)
    mixed = _opacity(torch.lerp(start, end, torch.full_like(start, share)))
    stays = (factors == 1) | (share == 0)
    return torch.where(stays, opacities, mixed.to(opacities))


def _appeared(opacities: Float[Tensor, " C"], strength: float) -> Float[Tensor, " C"]:
    """Opacities of a canvas; to the bit at full strength.

    Logarithms of what is let through add up along a ray. So a pile of discs shows as much as is
    wanted, and not more for being a pile.
    """
    if strength >= 1:
        return opacities
    share = min(1.0, math.log(1 - strength) / math.log(THROUGH))
    return _opacity(-F.softplus(opacities.double()) * share).to(opacities)


def _opacity(let_through: Float[Tensor, " N"]) -> Float[Tensor, " N"]:
    """Logits of opacities that let so much through, given as logarithms."""
    return torch.log(torch.expm1(-let_through)).clamp(min=UNSEEN)
