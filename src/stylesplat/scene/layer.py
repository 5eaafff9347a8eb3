"""The `Layer` noun: the paint of one object, or its change of colours, apart from the splat."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from stylesplat.errors import counted, one_line, some
from stylesplat.scene.splats import Splats

Kind = Literal["paint", "recolour"]
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

    Gaussians of layers beneath belong to a row of the base (see `parents`); this layer treats them
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
    canvas: Splats
    """The layer's own Gaussians, which have no identities."""
    canvas_sh0: Float[Tensor, "C 1 3"]
    """Colours of the canvas before it was painted. Strengths above 1 lead away from them."""
    parents: Int[Tensor, " C"]
    """The row of the base that each Gaussian of the canvas belongs to."""
    relief: Float[Tensor, " L"]
    """The luminance detail of the unpainted object, in 0..1: of the rows, then of the canvas."""
    strength: float = 1.0
    """How much of the paint shows, 0 to 1.5."""
    form: float = 0.0
    """How much of the relief shows, 0 to 1.5."""
    visible: bool = True
    """Whether the layer is shown."""
    kind: Kind = "paint"
    """The kind of the layer."""
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

    def __repr__(self) -> str:
        pictures = some(each.path.name if each.path else "a picture" for each in self.styles)
        if self.color_map is not None:
            shown = f"strength {self.strength:g}" if self.visible else "hidden"
            return one_line(self, self.name, counted(len(self.rows), "Gaussian"), shown)
        gaussians = counted(len(self.rows), "Gaussian")
        new = f"{len(self.canvas):,} new" if len(self.canvas) else None
        shown = f"strength {self.strength:g}" if self.visible else "hidden"
        return one_line(
            self, f"{self.object} like {pictures}", gaussians, new, shown, self.features
        )

    @property
    def name(self) -> str:
        """The layer's own name: the object's, with "/recolor" behind it for a recolouring."""
        return self.object if self.color_map is None else f"{self.object}{RECOLOR}"

    @property
    def is_shown(self) -> bool:
        return self.visible and self.strength > 0

    @property
    def painted_form(self) -> float:
        return float(self.settings.get("form", 0.0))

    def to(self, device: torch.device | str) -> "Layer":
        moved = {n: t.to(device) for n, t in vars(self).items() if isinstance(t, Tensor)}
        return replace(self, **moved, canvas=self.canvas.to(device))


def recoloring(
    object: str, rows: Int[Tensor, " R"], color_map: Float[Tensor, "3 4"], **columns: Any
) -> Layer:
    """The layer that maps the colours of some rows, and of what lies on them; columns as given."""
    count, one = len(rows), torch.ones(1).expand(len(rows))
    names = "means", "quats", "scales", "opacities", "sh0", "shN"
    shapes = (3,), (4,), (3,), (), (1, 3), (0, 3)
    empty: dict[str, Any] = {n: torch.zeros(0, *s) for n, s in zip(names, shapes, strict=True)}
    canvas = Splats(**empty)
    return Layer(
        object,
        rows,
        **{"shares": one, **columns},
        sh0=torch.zeros(1, 1, 3).expand(count, 1, 3),
        shN=torch.zeros(1, 0, 3).expand(count, 0, 3),
        opacity_factors=one,
        canvas=canvas,
        canvas_sh0=canvas.sh0,
        parents=rows[:0],
        relief=torch.zeros(1).expand(count),
        kind="recolour",
        color_map=color_map,
    )


def appearance_only(splats: Splats) -> Splats:
    return replace(splats, identities=None, classifier=None, confidence=None)


def layer_subset(
    layer: Layer, places: Int[Tensor, " N"], canvas: Int[Tensor, " K"] | None = None
) -> Layer:
    """The part of a layer on some rows of its base, and on some of its canvas (by default all).

    `places` are the new rows of the base's rows, -1 where they are removed. Gaussians of the canvas
    whose parent is removed get any row of the layer as parent.
    """
    kept = places[layer.rows] >= 0
    rows = places[layer.rows][kept]
    left = torch.arange(len(layer.parents)) if canvas is None else canvas
    parents = places[layer.parents[left]]
    return replace(
        layer,
        rows=rows,
        **{n: getattr(layer, n)[kept] for n in ("shares", "sh0", "shN", "opacity_factors")},
        canvas=layer.canvas[left],
        canvas_sh0=layer.canvas_sh0[left],
        parents=torch.where(parents < 0, rows[0] if len(rows) else 0, parents),
        relief=torch.cat([layer.relief[: len(kept)][kept], layer.relief[len(kept) :][left]]),
    )
