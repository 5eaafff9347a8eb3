"""What has been painted on a scene, and what it takes to change or undo that."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import some
from stylesplat.scene.one_line import counted, one_line
from stylesplat.scene.splats import Splats


@dataclass(frozen=True)
class Source:
    """A file that something was made from."""

    path: Path | None
    """Where it lay; None if it was never a file."""
    sha256: str | None = None
    """Digest of its content; None if nobody took it."""


@dataclass(frozen=True)
class Painting:
    """One object, as it was painted once."""

    name: str
    """What it was called then: a name, or a label id."""
    picked: Bool[Tensor, " N"]
    """Its Gaussians, whatever the name means now."""
    styles: tuple[Source, ...]
    """The pictures whose style it has."""
    settings: Mapping[str, Any]
    """All of them, as plain values; the intensity among them is that at first."""
    intensity: float
    """How much of the new colours shows now, 0 to 1.5."""
    features: str
    """The network whose features were matched."""
    weights: Source | None = None
    """The network's file, if it was not its own."""
    upon: Mapping[str, float] = field(default_factory=dict)
    """The paintings that were there before, by name, and how strong they were then."""
    precision: str | None = None
    """In which features were computed; None if nobody kept it."""

    def __repr__(self) -> str:
        pictures = some(each.path.name if each.path else "a picture" for each in self.styles)
        gaussians = counted(int(self.picked.sum()), "Gaussian")
        strength = f"intensity {self.intensity:g}"
        return one_line(self, f"{self.name} like {pictures}", gaussians, strength, self.features)


@dataclass(frozen=True)
class Gone:
    """A painting that was taken back, but that others were painted upon while it was there."""

    painting: Painting
    """As it was, but of no Gaussians."""
    place: int
    """How many of the paintings that are there now are older."""


@dataclass(frozen=True)
class Unsplit:
    """What it takes to undo splits, besides the looks before."""

    count: int
    """How many Gaussians there were; what follows them is new."""
    rows: Int[Tensor, " R"]
    """Those that were split."""
    scales: Float[Tensor, "R 3"]
    """Theirs before."""
    opacities: Float[Tensor, " R"]
    """Theirs before."""

    def __repr__(self) -> str:
        return one_line(self, f"{len(self.rows):,} of {counted(self.count, 'Gaussian')} were split")


@dataclass(frozen=True)
class Looks:
    """The colours and opacities of all Gaussians of a scene."""

    sh0: Float[Tensor, "N 1 3"]
    """Constant band."""
    shN: Float[Tensor, "N _ 3"]
    """Higher bands."""
    opacities: Float[Tensor, " N"]
    """Logits. They differ between two looks where a canvas was laid, and in what it hides."""

    def __repr__(self) -> str:
        return one_line(self, f"of {counted(len(self.sh0), 'Gaussian')}")

    @classmethod
    def of(cls, splats: Splats) -> "Looks":
        """Those of splats."""
        return cls(splats.sh0, splats.shN, splats.opacities)

    def on(self, splats: Splats) -> Splats:
        """The splats looking so."""
        return replace(splats, **{name: each.to(splats.means) for name, each in vars(self).items()})

    def __getitem__(self, rows: Int[Tensor, " M"]) -> "Looks":
        return Looks(**{name: each[rows] for name, each in vars(self).items()})


@dataclass(frozen=True)
class Painted:
    """All that was painted on a scene, in order."""

    paintings: tuple[Painting, ...]
    """At least one, of Gaussians that no two of them share."""
    before: Looks
    """Without any painting."""
    full: Looks
    """With all of them at intensity 1."""
    unsplit: Unsplit | None = None
    """The shapes of Gaussians that were split; None if none were."""
    origin: Path | None = None
    """The folder of the scene before; None if it had none."""
    gone: tuple[Gone, ...] = ()
    """What else it takes to paint all this again, the oldest first."""

    def __repr__(self) -> str:
        return one_line(self, some(self.names))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the objects, in order."""
        return tuple(painting.name for painting in self.paintings)

    @property
    def everything(self) -> Bool[Tensor, " N"]:
        """All Gaussians that were painted."""
        return torch.stack([painting.picked for painting in self.paintings]).any(dim=0)

    @property
    def history(self) -> tuple[tuple[Painting, bool], ...]:
        """All paintings in the order in which they were made, and whether each is there."""
        ordered: list[tuple[Painting, bool]] = []
        for number in range(len(self.paintings) + 1):
            ordered += [(each.painting, False) for each in self.gone if each.place == number]
            ordered += [(each, True) for each in self.paintings[number : number + 1]]
        return tuple(ordered)
