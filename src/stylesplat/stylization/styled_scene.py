"""A scene put together again from objects that were painted by themselves."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.scene.splats import Splats
from stylesplat.stylization.cut_scene import CutScene


@dataclass(frozen=True)
class Styled:
    """A styled scene, and the way back from it."""

    splats: Splats
    """With the new colours. Split Gaussians' further children follow all others."""
    full: Splats
    """The same at full intensity."""
    base: Splats
    """The same as it looked before."""
    parents: Int[Tensor, " N"]
    """Which Gaussian of the scene before each one comes from."""
    cuts: Mapping[str, CutScene] = field(default_factory=dict)
    """By name what of a large scene objects were painted in."""


@dataclass(frozen=True)
class Piece:
    """What became of one object: its own Gaussians, then those that are new."""

    rows: Int[Tensor, " R"]
    """Which of the scene its own are."""
    styled: Styled
    """These alone; the parents are rows of the scene."""


def piece_of(
    alone: Styled, picked: Bool[Tensor, " N"], rows: Int[Tensor, " N"] | None = None
) -> Piece:
    """The object of a scene in which nothing else was painted.

    Args:
        alone: That scene.
        picked: The object's Gaussians, before.
        rows: Which Gaussians of a larger scene these are; None if they are all there are.
    """
    own = picked.nonzero()[:, 0]
    new = torch.arange(len(picked), len(alone.parents), device=own.device)
    kept = torch.cat([own, new])
    parents = alone.parents[kept]
    return Piece(
        rows=own if rows is None else rows[own],
        styled=Styled(
            splats=alone.splats[kept],
            full=alone.full[kept],
            base=alone.base[kept],
            parents=parents if rows is None else rows[parents],
        ),
    )


def assembled(splats: Splats, pieces: Sequence[Piece]) -> Styled:
    """A scene with objects in their new looks, which takes no memory for what stays the same.

    Args:
        splats: The scene before.
        pieces: What its objects became, which share no Gaussians.
    """
    rows = torch.cat([piece.rows for piece in pieces])
    everyone = torch.arange(len(splats), device=splats.device)
    known: list[_Put] = []

    def joined(look: Callable[[Styled], Splats]) -> Splats:
        looks = [look(piece.styled).tensors() for piece in pieces]
        sizes = [len(piece.rows) for piece in pieces]
        tensors = {}
        for name, tensor in splats.tensors().items():
            own = [each[name][:size] for each, size in zip(looks, sizes, strict=True)]
            new = [each[name][size:] for each, size in zip(looks, sizes, strict=True)]
            tensors[name] = _put(tensor, rows, torch.cat([*own, *new]), known)
        return replace(splats, **tensors)

    return Styled(
        splats=joined(lambda styled: styled.splats),
        full=joined(lambda styled: styled.full),
        base=joined(lambda styled: styled.base),
        parents=torch.cat([everyone, *(p.styled.parents[len(p.rows) :] for p in pieces)]),
    )


class _Put(NamedTuple):
    """What was put together once."""

    before: Tensor
    part: Tensor
    whole: Tensor


def _put(before: Tensor, rows: Tensor, part: Tensor, known: list[_Put]) -> Tensor:
    """A tensor with some rows replaced, and more at its end; the same one for the same values."""
    for each in known:
        if each.before is before and torch.equal(each.part, part):
            return each.whole
    own, new = part.split([len(rows), len(part) - len(rows)])
    if len(new):
        whole = torch.cat([before, new]).index_copy_(0, rows, own)
    elif torch.equal(before[rows], own):
        whole = before
    else:
        whole = before.index_copy(0, rows, own)
    known.append(_Put(before, part, whole))
    return whole
