"""Objects of a scene: the noun, names, and lists of an object's Gaussians."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, count_noun, noun_repr, shorten
from stylesplat.scene.selection import Selection

OBJECT_MAX_NAME = 100  # characters of an object's name
RESERVED = "__metadata__"  # of safetensors files
# Folders, the sign of OBJECT=IMAGE, control characters and line ends, halves of characters
OBJECT_UNFIT = re.compile(r"[/\\=\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A named object."""

    mask: Bool[Tensor, " B"]
    """Its rows of the scene's base. Surfels of layers belong to what their parents belong to."""
    selection: Selection = field(default_factory=Selection)

    def __repr__(self) -> str:
        named = " ".join(map(str, self.selection.ids))
        share = f"{int(self.mask.sum()):,} of {count_noun(len(self.mask), 'Gaussian')}"
        return noun_repr(self, share, f"label ids {named}" if named else None)


def check_name(name: str) -> None:
    """Refuse a name that no object can have."""
    fault = name_fault(name)
    if fault:
        raise StyleSplatError(
            f"Cannot call an object {shorten(name)!r}: {fault}. Choose another name."
        )


def check_name_or_id(name: str) -> None:
    if not is_id(name):
        check_name(name)


def is_id(name: str) -> bool:
    """Whether a name is a label id; `int` refuses thousands of digits."""
    return name.isdecimal() and len(name) <= OBJECT_MAX_NAME


def name_fault(name: str) -> str | None:
    """The reason why no object can have a name, or None."""
    if not name.strip():
        return "a name must not be empty"
    if name.isdecimal():
        return "numbers are label ids"
    if OBJECT_UNFIT.search(name):
        return "names must not contain '=', slashes or control characters"
    if name == RESERVED:
        return "files of objects use that name for themselves"
    return (
        f"names have at most {OBJECT_MAX_NAME} characters" if len(name) > OBJECT_MAX_NAME else None
    )


def free_name(name: str, taken: Callable[[str], object], between: str = " ") -> str:
    """The name, or the first of `name 2`, `name 3` and so on that is not taken."""
    names = (name if n == 1 else f"{name}{between}{n}" for n in count(1))
    return next(each for each in names if not taken(each))


@dataclass(frozen=True, eq=False)
class ListedObject:
    """The Gaussians of an object by row."""

    rows: Int[Tensor, " M"]
    shares: Float[Tensor, " M"] | None = None
    """The share of each Gaussian that belongs to the object, 0 to 1; None if unknown."""
    ids: tuple[int, ...] = ()
    """Its label ids."""


@dataclass(frozen=True, eq=False)
class ListedObjects:
    """All objects of a splat of `count` Gaussians."""

    count: int
    objects: Mapping[str, ListedObject] = field(default_factory=dict)
    """By name, or by label id if an object has no name."""
    labels: Int[Tensor, " N"] | None = None
    """The label id of each Gaussian, 0 for no object; None if there are none."""

    def ordered(self, order: Int[Tensor, " M"]) -> "ListedObjects":
        """The list for some of the Gaussians in another order; empty objects are dropped."""
        place = torch.full((self.count,), -1)
        place[order] = torch.arange(len(order))
        objects = dict[str, ListedObject]()
        for name, each in self.objects.items():
            rows, indices = place[each.rows].sort()
            indices = indices[rows >= 0]
            if len(indices):
                shares = None if each.shares is None else each.shares[indices]
                objects[name] = replace(each, rows=rows[rows >= 0], shares=shares)
        labels = None if self.labels is None else self.labels[order]
        return ListedObjects(len(order), objects, labels)
