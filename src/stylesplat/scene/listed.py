"""Objects as lists of Gaussians, for other programs and from them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Listed:
    """The Gaussians of an object."""

    rows: Int[Tensor, " M"]
    """Which they are."""
    shares: Float[Tensor, " M"] | None = None
    """How much of what each shows is the object, 0 to 1; None if nobody said."""
    ids: tuple[int, ...] = ()
    """Its label ids."""


@dataclass(frozen=True)
class ListedObjects:
    """The objects of a splat's Gaussians."""

    count: int
    """Of Gaussians."""
    objects: Mapping[str, Listed] = field(default_factory=dict)
    """By name; what has none is called by its label id."""
    labels: Int[Tensor, " N"] | None = None
    """The label id of each Gaussian, 0 being that of no object; None if there are none."""

    def ordered(self, order: Int[Tensor, " M"]) -> "ListedObjects":
        """The same for some of the Gaussians in another order: what has none left is dropped."""
        place = torch.full((self.count,), -1)
        place[order] = torch.arange(len(order))
        objects = dict[str, Listed]()
        for name, each in self.objects.items():
            rows, indices = place[each.rows].sort()
            indices = indices[rows >= 0]
            if len(indices):
                shares = None if each.shares is None else each.shares[indices]
                objects[name] = replace(each, rows=rows[rows >= 0], shares=shares)
        labels = None if self.labels is None else self.labels[order]
        return ListedObjects(len(order), objects, labels)

    def shares(self) -> Float[Tensor, " N"]:
        """How much of what each Gaussian shows is the object that it belongs to most."""
        shares = torch.zeros(self.count)
        for each in self.objects.values():
            if each.shares is not None:
                shares[each.rows] = torch.maximum(shares[each.rows], each.shares)
        return shares

    def numbered(self) -> Int[Tensor, " N"]:
        """The labels; where there are none the first object has 1, the second 2, and so on."""
        if self.labels is not None:
            return self.labels
        labels = torch.zeros(self.count, dtype=torch.int64)
        for number, each in reversed([*enumerate(self.objects.values(), 1)]):
            labels[each.rows] = number
        return labels
