"""A base and a stack of layers composed to one splat."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError, pasted
from stylesplat.scene.layer import RECOLOR, Layer
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import SH_C0, Splats, map_bands

UNSEEN = -16.0  # logit of an opacity that no picture shows
THROUGH = 0.003  # transmittance of a whole canvas, which makes the visible strength linear


def compose(base: Splats, layers: Sequence[Layer]) -> Splats:
    """The base with layers upon it: its rows, then the canvases in the order of the stack.

    Colours of the covered rows are interpolated towards the layer's by strength times share, and
    extrapolated above 1. Renders are linear in the colours, so that they blend likewise, wherever
    no colour is clamped. The canvas fades in with the strength; from strength 0.5 on, the rows that
    it hides fade out. Layers that are hidden or of strength 0 change nothing, to the bit.
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
    return family_of(scene.unpainted, scene.layers)


def with_layers(scene: Scene, layers: Sequence[Layer]) -> Scene:
    """The scene with another stack of layers.

    Gaussians of a canvas that is there before and after keep their objects; those of a new canvas
    belong to the objects of their parents. Objects that lose all of their Gaussians go.
    """
    base = scene.unpainted
    rows = _rows_before(scene, layers)
    objects = {name: object_subset(each, rows) for name, each in scene.objects.items()}
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
    """The scene beneath the layer of a name, and the layer's index; of a new layer, the top."""
    place = next((n for n, each in enumerate(scene.layers) if each.name == name), None)
    if place is None:
        return scene, len(scene.layers)
    return replace(with_layers(scene, scene.layers[:place]), path=scene.path), place


def without_layers(scene: Scene, names: Collection[str] | None = None) -> Scene:
    """The scene without the layers of some names, by default without any."""
    if names is not None and not names:
        return scene
    require_painted(scene, names or ())
    left = [each for each in scene.layers if names is not None and each.name not in names]
    metrics = scene.metrics.get("train", {})
    return replace(with_layers(scene, left), metrics={"train": metrics} if left else metrics)


def with_strengths(
    scene: Scene, strengths: Mapping[str, float], forms: Mapping[str, float] | None = None
) -> Scene:
    """The scene with other strengths and forms of some layers, by name."""
    layers = list[Layer]()
    for each in scene.layers:
        strength = strengths.get(each.name, each.strength)
        form = (forms or {}).get(each.name, each.form)
        same = (strength, form) == (each.strength, each.form)
        layers.append(each if same else replace(each, strength=strength, form=form))
    unchanged = all(new is old for new, old in zip(layers, scene.layers, strict=True))
    return scene if unchanged else with_layers(scene, layers)


def strengths_of(scene: Scene) -> dict[str, float]:
    return {each.name: each.strength for each in scene.layers}


def named_layers(scene: Scene, names: Collection[str]) -> list[str]:
    """The layers that names stand for: an object's paint, or what recolours it if it has none."""
    known = strengths_of(scene)
    own = [n if n in known or f"{n}{RECOLOR}" not in known else f"{n}{RECOLOR}" for n in names]
    require_painted(scene, own)
    return own


def require_painted(scene: Scene, names: Collection[str] = ()) -> None:
    """Refuse a scene without layers, or without layers of some names."""
    if not scene.layers:
        way = pasted("stylize", scene.path or "SCENE", "--style", "OBJECT=IMAGE", "-o", "STYLED")
        raise StyleSplatError(
            f"{scene.path or 'The scene'} is not styled. Style it first: `{way}`."
        )
    known = strengths_of(scene)
    unknown = next((name for name in names if name not in known), None)
    if unknown is not None:
        raise StyleSplatError(
            f"{unknown} is not styled in {scene.path or 'this scene'}. "
            f"Styled objects: {', '.join(known)}."
        )


def mask_of(layer: Layer, scene: Scene) -> Bool[Tensor, " M"]:
    """The Gaussians of a scene that belong to the rows that a layer covers."""
    own = torch.zeros(len(scene.unpainted), dtype=torch.bool)
    own[layer.rows] = True
    return own[family(scene)]


def spans(scene: Scene) -> list[tuple[Layer, int, int]]:
    """The layers that show, and the first row and the end of their canvases in the splats."""
    shown = [layer for layer in scene.layers if layer.is_shown]
    ends = [*accumulate((len(layer.parents) for layer in shown), initial=len(scene.unpainted))]
    return [*zip(shown, ends, ends[1:], strict=False)]


def canvases_last(scene: Scene, names: Collection[str]) -> Splats:
    """The splats of a scene with the canvases of some objects last."""
    parts = sorted(spans(scene), key=lambda part: part[0].object in names)
    order = [torch.arange(first, end) for _, first, end in parts]
    return scene.splats[torch.cat([torch.arange(len(scene.unpainted)), *order])]


def splats_without_paint(scene: Scene) -> Splats:
    """All Gaussians of a scene without paint; those of canvases are transparent."""
    canvases = scene.splats[len(scene.unpainted) :]
    hidden = torch.full_like(canvases.opacities, UNSEEN)
    return Splats.cat([scene.unpainted, replace(canvases, opacities=hidden)])


def object_subset(each: SceneObject, rows: Int[Tensor, " M"]) -> SceneObject:
    """An object among the Gaussians of some rows."""
    picked = each.picked[rows]
    count = {"gaussians": int(picked.sum())} if "gaussians" in each.how else {}
    return SceneObject(picked, {**each.how, **count})


def _rows_before(scene: Scene, layers: Sequence[Layer]) -> Int[Tensor, " M"]:
    """The present row of each Gaussian of the scene with other layers; its parent's if new."""
    starts = {id(layer.parents): first for layer, first, _ in spans(scene)}
    parts = [torch.arange(len(scene.unpainted))]
    for layer in layers:
        if layer.is_shown:
            first = starts.get(id(layer.parents))
            own = torch.arange(len(layer.parents))
            parts.append(layer.parents if first is None else first + own)
    return torch.cat(parts)


def _covered(splats: Splats, family: Int[Tensor, " M"], layer: Layer, count: int) -> Splats:
    """The splats beneath a layer with its paint on the rows that it covers."""
    entry = family.new_full((count,), -1)
    entry[layer.rows] = torch.arange(len(layer.rows), device=family.device)
    entries = entry[family]
    rows = (entries >= 0).nonzero()[:, 0]
    entries = entries[rows]
    weights = (layer.strength * layer.shares)[entries, None, None]
    if layer.color_map is not None:
        under = splats.sh0[rows], splats.shN[rows]
        mapped = map_bands(*under, layer.color_map)
        bands = (torch.lerp(*pair, weights) for pair in zip(under, mapped, strict=True))
        return splats.with_rows(rows, dict(zip(("sh0", "shN"), bands, strict=True)))
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
        antialiased=base.antialiased,
    )
    return Splats.cat([splats, canvas])


def _form(layer: Layer) -> Float[Tensor, " L"]:
    """The change of the constant band for the form that the paint does not have yet."""
    return layer.relief * ((layer.form - layer.painted_form) / SH_C0)


def _faded(
    opacities: Float[Tensor, " R"], factors: Float[Tensor, " R"], strength: float
) -> Float[Tensor, " R"]:
    """The opacities of the rows that a layer hides; exact where nothing fades."""
    share = max(0.0, 2 * min(strength, 1.0) - 1)
    hidden = torch.sigmoid(opacities.double()) * factors
    # Logarithms of transmittances, in float64: float32 differs in the last bit by the row
    start, end = -F.softplus(opacities.double()), torch.log1p(-hidden)
    mixed = _opacity(torch.lerp(start, end, torch.full_like(start, share)))
    stays = (factors == 1) | (share == 0)
    return torch.where(stays, opacities, mixed.to(opacities))


def _appeared(opacities: Float[Tensor, " C"], strength: float) -> Float[Tensor, " C"]:
    """The opacities of a canvas; exact at full strength.

    Logarithms of transmittances add up along a ray, so that the strength is right also where
    several discs overlap.
    """
    if strength >= 1:
        return opacities
    share = min(1.0, math.log(1 - strength) / math.log(THROUGH))
    return _opacity(-F.softplus(opacities.double()) * share).to(opacities)


def _opacity(log_transmittance: Float[Tensor, " N"]) -> Float[Tensor, " N"]:
    return torch.log(torch.expm1(-log_transmittance)).clamp(min=UNSEEN)
