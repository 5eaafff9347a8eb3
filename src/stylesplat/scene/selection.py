"""How an object is selected, as plain values."""

from typing import Annotated

import msgspec
from msgspec import Meta

from stylesplat.options import PickSize
from stylesplat.scene.capture import MAX_ID

THRESHOLD = 0.5  # a Gaussian is picked when its object is likelier than all others together
LabelId = Annotated[int, Meta(ge=0, le=MAX_ID)]
Point = tuple[float, float]
ViewBox = tuple[float, float, float, float]
Ball = Annotated[tuple[float, ...], Meta(min_length=3, max_length=4)]


class Selection(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The union of all that is named, without what is excluded, cut to an object, then grown.

    Its fields are the keys of an object in `objects.json`; see the arguments of `select`.
    """

    ids: tuple[LabelId, ...] = ()
    """Label ids. Once they are found, also those that boxes, points and texts mean."""
    threshold: float = THRESHOLD
    keep_outliers: bool = False
    boxes: tuple[tuple[str, ViewBox], ...] = ()
    points: tuple[tuple[str, Point], ...] = ()
    not_points: tuple[tuple[str, Point], ...] = ()
    of: str | None = None
    size: PickSize | None = None
    text: tuple[str, ...] = ()
    model: str | None = None
    box3d: tuple[tuple[float, float, float, float, float, float], ...] = ()
    sphere: tuple[tuple[str, Ball], ...] = ()
    """A view and a pixel of it, or no view and a centre; and the radius."""
    rows: tuple[str, ...] = ()
    """Files that list Gaussians; or `IN_MEMORY`."""
    plus: tuple[str, ...] = ()
    minus: tuple[str, ...] = ()
    all: bool = False
    background: bool = False
    grow: float | None = None
    shrink: float | None = None
    scores: dict[int, float] = {}
    """How well label ids fit the texts."""

    @property
    def is_whole(self) -> bool:
        """Whether it means the whole objects of its label ids and nothing else."""
        shaped = self.plus + self.minus + self.box3d + self.sphere + self.rows
        resized = self.of or self.size or self.grow or self.shrink
        return not (shaped or resized or self.all or self.background)


IN_MEMORY = ("a mask",)  # rows of a selection that no file lists
