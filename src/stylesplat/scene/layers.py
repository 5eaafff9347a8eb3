"""The `Layer` noun: the paint of one object, or its change of colours, apart from the splat.

`compose` shows a stack of layers on a base.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError, count_noun, join_names, noun_repr, shorten
from stylesplat.scene.objects import check_name_or_id
from stylesplat.scene.palette import map_palette
from stylesplat.scene.splats import LUMA, SH_C0, Splats, map_bands

UNSEEN = -16.0  # logit of an opacity that no picture shows
THROUGH = 0.003  # transmittance of all surfels, which makes the visible strength linear
LayerKind = Literal["paint", "recolour", "edit"]
Blend = Literal["normal", "luminosity", "colour"]
RELIEF_FORM, MOST_FORM = 1.0, 1.5  # up to the first relief shows, from there on sculpture
RECOLOR = "/recolor"  # after an object's name, in which there is no slash: its recolouring


@dataclass(frozen=True)
class Source:
    """A file that something was made from."""

    path: Path | None
    """The path of the file; None if it was never a file."""
    sha256: str | None = None
    """The digest of its content; None if it was not recorded."""


@dataclass(frozen=True, eq=False)
class Layer:
    """The paint of one object at full strength, and how much of it shows.

    Surfels of the layers below belong to a row of the base (see `parents`); this layer treats them
    as it treats that row. A recolouring has no paint but a `color_map` (see `recoloring`).
    """

    object: str
    """The object's name or label id."""
    rows: Int[Tensor, " R"]
    """The rows of the base that the layer covers."""
    shares: Float[Tensor, " R"]
    """The share of the paint that each row takes on."""
    sh0: Float[Tensor, "R 1 3"]
    """The paint of these rows: the constant band."""
    shN: Float[Tensor, "R _ 3"]
    """The paint of these rows: the higher bands."""
    opacity_factors: Float[Tensor, " R"]
    """Factors on the opacities at strength 1: 1 where nothing fades."""
    surfels: Splats
    """The layer's own Gaussians, which have no identities."""
    surfels_sh0: Float[Tensor, "C 1 3"]
    """Colours of the surfels before they were painted. Strengths above 1 lead away from them."""
    parents: Int[Tensor, " C"]
    """The row of the base that each surfel belongs to."""
    relief: Float[Tensor, " L"]
    """The luminance detail of the unpainted object, in -1..1: of the rows, then of the surfels."""
    strength: float = 1.0
    """How much of the paint shows, 0 to 1.5."""
    form: float = 0.0
    """How much of the object's form shows: of the relief up to 1, of the sculpture up to 1.5."""
    visible: bool = True
    """Whether the layer is shown."""
    kind: LayerKind = "paint"
    """The kind of the layer."""
    label: str = ""
    """What tells the layer from others of its object; empty for the first."""
    blend: Blend = "normal"
    """What of the colours it changes: all, the luminosity alone, or all but the luminosity."""
    mask: Float[Tensor, " R"] | None = None
    """How much of the layer each row shows, 0 to 1, and the surfels that belong to it."""
    styles: tuple[Source, ...] = ()
    """The pictures whose style the object has."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """All settings as plain values; strength and form among them are those of the painting."""
    features: str = "compact"
    """The network whose features were matched."""
    weights: Source | None = None
    """The network's file, if it was not the network's own."""
    precision: str | None = None
    """The precision of the features; None if it was not recorded."""
    color_map: Float[Tensor, "3 4"] | None = None
    """Of a recolouring: colours in 0..1 become `color_map @ (red, green, blue, 1)`."""
    palette: Float[Tensor, "K 6"] | None = None
    """Of a recolouring: colours in 0..1 and what becomes of them before the `color_map`; see
    `map_palette`."""
    sculpture: Float[Tensor, " L"] | None = None
    """The luminance to add at a form of 1.5, as `relief`. Without it relief goes on beyond 1, as in
    layers of earlier versions."""

    def __repr__(self) -> str:
        gaussians = count_noun(len(self.rows), "Gaussian")
        shown = f"strength {self.strength:g}" if self.visible else "hidden"
        if self.kind != "paint":
            return noun_repr(self, self.name, gaussians, shown)
        pictures = join_names(each.path.name if each.path else "a picture" for each in self.styles)
        new = f"{len(self.surfels):,} new" if len(self.surfels) else None
        return noun_repr(
            self, f"{self.object} like {pictures}", gaussians, new, shown, self.features
        )

    @property
    def name(self) -> str:
        """The layer's own name: the object's, with a label behind it ("/recolor")."""
        label = self.label or ("" if self.color_map is None else RECOLOR[1:])
        return f"{self.object}/{label}" if label else self.object

    @property
    def is_shown(self) -> bool:
        return self.visible and self.strength > 0

    @property
    def painted_form(self) -> float:
        return float(self.settings.get("form", 0.0))

    def to(self, device: torch.device | str) -> "Layer":
        moved = {n: t.to(device) for n, t in vars(self).items() if isinstance(t, Tensor)}
        return replace(self, **moved, surfels=self.surfels.to(device))

    def whole_mask(self, count: int) -> Float[Tensor, " B"]:
        """The mask for all rows of a base of `count` Gaussians: 1 where there is none."""
        whole = torch.ones(count, device=self.rows.device)
        return whole if self.mask is None else whole.index_copy(0, self.rows, self.mask)

    def covered(self, count: int) -> Bool[Tensor, " B"]:
        """The rows that the layer covers, of a base of `count` Gaussians."""
        covered = torch.zeros(count, dtype=torch.bool, device=self.rows.device)
        return covered.index_fill(0, self.rows, True)


def shown_like(layer: Layer, other: Layer | None, count: int) -> Layer:
    """A layer with the blend and the mask of another on a base of `count` Gaussians, if any."""
    if other is None:
        return layer
    mask = None if other.mask is None else other.whole_mask(count)[layer.rows.cpu()]
    return replace(layer, blend=other.blend, mask=mask)


LAYER_LABEL = r"\A(?!recolor\Z)[\w .-]{0,40}\Z"


def split_name(name: str) -> tuple[str, str]:
    """The object and the label of a layer's name."""
    object, _, label = name.partition("/")
    return object, label


def check_layer_name(name: str) -> None:
    """Refuse a name that no layer of paint can have."""
    object, label = split_name(name)
    check_name_or_id(object)
    if not re.match(LAYER_LABEL, label) or (not label and "/" in name):
        raise StyleSplatError(
            f"No layer can be called {shorten(name)!r}: behind the slash come up to 40 letters and "
            "digits, as in vase/2. Choose another name."
        )


def recoloring(
    object: str, rows: Int[Tensor, " R"], color_map: Float[Tensor, "3 4"], **columns: Any
) -> Layer:
    """The layer that maps the colours of some rows, and of what lies on them; columns as given."""
    count, one = len(rows), torch.ones(1).expand(len(rows))
    names = "means", "quats", "scales", "opacities", "sh0", "shN"
    shapes = (3,), (4,), (3,), (), (1, 3), (0, 3)
    empty: dict[str, Any] = {n: torch.zeros(0, *s) for n, s in zip(names, shapes, strict=True)}
    surfels = Splats(**empty)
    return Layer(
        object,
        rows,
        **{"shares": one, **columns},
        sh0=torch.zeros(1, 1, 3).expand(count, 1, 3),
        shN=torch.zeros(1, 0, 3).expand(count, 0, 3),
        opacity_factors=one,
        surfels=surfels,
        surfels_sh0=surfels.sh0,
        parents=rows[:0],
        relief=torch.zeros(1).expand(count),
        kind="recolour",
        color_map=color_map,
    )


def edited(
    object: str,
    label: str,
    rows: Int[Tensor, " R"],
    shares: Float[Tensor, " R"],
    opacity_factors: Float[Tensor, " R"],
    sh0: Float[Tensor, "R 1 3"],
    shN: Float[Tensor, "R _ 3"],
    **columns: Any,
) -> Layer:
    """The layer that removes or recolours some rows, and what lies on them, as it is told."""
    layer = recoloring(object, rows, torch.zeros(3, 4), shares=shares, **columns)
    layer = replace(layer, kind="edit", label=label, color_map=None, sh0=sh0)
    return replace(layer, shN=shN, opacity_factors=opacity_factors)


def appearance_only(splats: Splats) -> Splats:
    return replace(splats, identities=None, classifier=None, confidence=None)


def layer_subset(
    layer: Layer, places: Int[Tensor, " B"], kept: Int[Tensor, " K"] | None = None
) -> Layer:
    """The part of a layer on some rows of its base, and some surfels, by default those of the rows.

    `places` are the new rows of the base's rows, -1 where they are removed. A kept surfel whose
    parent is removed gets any row of the layer as its parent.
    """
    own, parents = places[layer.rows] >= 0, places[layer.parents]
    kept = (parents >= 0).nonzero()[:, 0] if kept is None else kept
    rows, parents = places[layer.rows][own], parents[kept]
    of_either = torch.cat([own.nonzero()[:, 0], len(own) + kept])
    return replace(
        layer,
        rows=rows,
        **{n: getattr(layer, n)[own] for n in ("shares", "sh0", "shN", "opacity_factors")},
        surfels=layer.surfels[kept],
        surfels_sh0=layer.surfels_sh0[kept],
        parents=torch.where(parents < 0, rows[0] if len(rows) else 0, parents),
        relief=layer.relief[of_either],
        sculpture=None if layer.sculpture is None else layer.sculpture[of_either],
        mask=None if layer.mask is None else layer.mask[own],
    )


@dataclass(frozen=True, eq=False)
class Composed:
    """A base and the layers upon it as one splat."""

    base: Splats
    layers: tuple[Layer, ...]
    splats: Splats
    """The rows of the base, then the surfels in the order of the stack."""
    parents: Int[Tensor, " N"]
    """The row of the base that each row of `splats` belongs to."""

    def is_below(self, base: Splats, layers: Sequence[Layer]) -> bool:
        """Whether the stack begins with these very layers on this very base."""
        same = all(one is other for one, other in zip(self.layers, layers, strict=False))
        return self.base is base and len(self.layers) <= len(layers) and same


def compose(base: Splats, layers: Sequence[Layer], known: Composed | None = None) -> Composed:
    """Compose layers onto a base, the lowest first; goes on from `known` if the stack begins so.

    Colours of the covered rows are interpolated towards the layer's by strength times share, and
    extrapolated above 1. Renders are linear in the colours, so that they blend likewise, wherever
    no colour is clamped. The surfels fade in with the strength; from strength 0.5 on, the rows that
    they hide fade out. A mask lowers the strength row by row. Layers that are hidden or of strength
    0 change nothing, to the bit.
    """
    if known is None or not known.is_below(base, layers):
        known = Composed(base, (), base, torch.arange(len(base), device=base.device))
    splats, parents = known.splats, known.parents
    for layer in layers[len(known.layers) :]:
        if layer.is_shown:
            splats = _with_surfels(_covered(splats, parents, layer, len(base)), base, layer)
            parents = torch.cat([parents, layer.parents])
    return Composed(base, tuple(layers), splats, parents)


def _covered(splats: Splats, parents: Int[Tensor, " M"], layer: Layer, count: int) -> Splats:
    """The splats below a layer with its paint on the rows that it covers."""
    entry = parents.new_full((count,), -1)
    entry[layer.rows] = torch.arange(len(layer.rows), device=parents.device)
    entries = entry[parents]
    rows = (entries >= 0).nonzero()[:, 0]
    entries = entries[rows]
    shares = layer.shares if layer.mask is None else layer.shares * layer.mask
    weights = (layer.strength * shares)[entries, None, None]
    under = splats.sh0[rows], splats.shN[rows]
    if layer.color_map is not None:
        changed = under if layer.palette is None else map_palette(*under, layer.palette)
        paint = map_bands(*changed, layer.color_map)
    else:
        sh0 = layer.sh0 + _form(layer)[: len(layer.rows), None, None]
        paint = sh0[entries], layer.shN[entries]
    paint = (_blended(layer.blend, *pair) for pair in zip(paint, under, strict=True))
    bands = (torch.lerp(*pair, weights) for pair in zip(under, paint, strict=True))
    tensors = dict[str, Tensor](zip(("sh0", "shN"), bands, strict=True))
    if layer.color_map is None:
        factors, strength = layer.opacity_factors[entries], layer.strength
        strengths = strength if layer.mask is None else strength * layer.mask[entries].double()
        tensors["opacities"] = _faded(splats.opacities[rows], factors, strengths)
    return splats.with_rows(rows, tensors)


def _blended(
    blend: Blend, paint: Float[Tensor, "*R 3"], under: Float[Tensor, "*R 3"]
) -> Float[Tensor, "*R 3"]:
    """Bands of paint with the luminosity, or the colour, of those below."""
    if blend == "normal":
        return paint
    brighter = ((under - paint) @ paint.new_tensor(LUMA))[..., None]
    return paint + brighter if blend == "colour" else under - brighter


def _with_surfels(splats: Splats, base: Splats, layer: Layer) -> Splats:
    surfels, parents = layer.surfels, layer.parents
    if not len(surfels):
        return splats
    strengths: float | Tensor = layer.strength
    if layer.mask is not None:
        strengths = strengths * layer.whole_mask(len(base)).double()[parents]
    farther = max(layer.strength, 1.0)
    paint = surfels.sh0 + _form(layer)[len(layer.rows) :, None, None]
    paint = _blended(layer.blend, paint, layer.surfels_sh0)
    shN = _blended(layer.blend, surfels.shN, torch.zeros_like(surfels.shN))
    surfels = replace(
        surfels,
        sh0=torch.lerp(layer.surfels_sh0, paint, torch.full_like(paint, farther)),
        shN=shN * farther,
        opacities=_appeared(surfels.opacities, strengths),
        identities=None if base.identities is None else base.identities[parents],
        confidence=None if base.confidence is None else base.confidence[parents],
        antialiased=base.antialiased,
    )
    return Splats.cat([splats, surfels])


def _form(layer: Layer) -> Float[Tensor, " L"]:
    """The change of the constant band for the form that the paint does not have yet."""
    if layer.sculpture is None:
        return layer.relief * ((layer.form - layer.painted_form) / SH_C0)
    shown = layer.relief * (min(layer.form, RELIEF_FORM) - layer.painted_form)
    beyond = max(layer.form - RELIEF_FORM, 0.0) / (MOST_FORM - RELIEF_FORM)
    return (shown + beyond * layer.sculpture) / SH_C0


def _faded(
    opacities: Float[Tensor, " R"],
    factors: Float[Tensor, " R"],
    strength: float | Float[Tensor, " R"],
) -> Float[Tensor, " R"]:
    """The opacities of the rows that a layer hides; exact where nothing fades."""
    strength = torch.as_tensor(strength, dtype=torch.float64, device=opacities.device)
    share = (2 * strength.clamp(max=1.0) - 1).clamp(min=0.0)
    hidden = torch.sigmoid(opacities.double()) * factors
    # Logarithms of transmittances, in float64: float32 differs in the last bit by the row
    start, end = -F.softplus(opacities.double()), torch.log1p(-hidden)
    mixed = _opacity(torch.lerp(start, end, share.expand_as(start)))
    stays = (factors == 1) | (share == 0)
    return torch.where(stays, opacities, mixed.to(opacities))


def _appeared(
    opacities: Float[Tensor, " C"], strength: float | Float[Tensor, " C"]
) -> Float[Tensor, " C"]:
    """The opacities of surfels; exact at full strength.

    Logarithms of transmittances add up along a ray, so that the strength is right also where
    several discs overlap.
    """
    if isinstance(strength, Tensor):
        share = torch.log1p(-strength.clamp(max=1 - THROUGH)) / math.log(THROUGH)
        appeared = _opacity(-F.softplus(opacities.double()) * share).to(opacities)
        return torch.where(strength < 1, appeared, opacities)
    if strength >= 1:
        return opacities
    share = min(1.0, math.log(1 - strength) / math.log(THROUGH))
    return _opacity(-F.softplus(opacities.double()) * share).to(opacities)


def _opacity(log_transmittance: Float[Tensor, " N"]) -> Float[Tensor, " N"]:
    return torch.log(torch.expm1(-log_transmittance)).clamp(min=UNSEEN)
