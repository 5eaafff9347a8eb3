"""The Gaussians of a file that can be drawn: limits become numbers, faulty rows are left out."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.packing import SMALLEST
from stylesplat.io.splats.splat_ply import SMALLEST_QUAT, splat_fault
from stylesplat.io.tensors import GAUSSIANS, as_rows, rows_in_range
from stylesplat.progress import say
from stylesplat.scene.splats import Splats

SURE = 30.0  # a logit: float32 has no opacity between its own and 1
FLAT = torch.tensor(SMALLEST).log().item()  # its square, which renders take, is 0


def drawable(splats: Splats, path: Path) -> tuple[Splats, Int[Tensor, " M"]]:
    """The Gaussians of a file that can be drawn, and their rows.

    A line says how many are left out and why; a StyleSplatError, if all are.
    """
    rows = torch.arange(len(splats))
    if not len(splats):
        raise StyleSplatError(f"There are no Gaussians in {path}. Choose another file.")
    if splat_fault(splats) is None:
        return splats, rows
    splats = _without_limits(splats)
    bad, reasons = torch.zeros(len(splats), dtype=torch.bool), list[str]()
    for mask, what in _faults(splats):
        count = int((mask & ~bad).sum())
        if count:
            reasons.append(f"{count:,} {what}")
        bad |= mask
    why = ", ".join(reasons)
    if bad.all():
        raise StyleSplatError(
            f"Cannot read {path} as splats: none of its {len(splats):,} Gaussians can be drawn "
            f"({why}). Export it again."
        )
    if not reasons:
        return splats, rows
    say(
        f"{path}: {int(bad.sum()):,} of {len(splats):,} Gaussians cannot be drawn and are left "
        f"out ({why})."
    )
    return splats[~bad], rows[~bad]


def _without_limits(splats: Splats) -> Splats:
    """The same with numbers for what has a limit as its logit or logarithm, and renders alike.

    An opacity of 1 or 0, a thickness of 0; and rotations whose quaternions are far from unit ones.
    """
    opacities, declared = splats.opacities, GAUSSIANS["opacities"]
    opacities = torch.where(opacities.isinf(), SURE * opacities.sign(), opacities)
    lengths = splats.quats.abs().amax(dim=1, keepdim=True)
    odd = (lengths > 0) & ~((SMALLEST_QUAT <= lengths) & (lengths <= GAUSSIANS["quats"].high))
    return replace(
        splats,
        opacities=opacities.clamp(declared.low, declared.high),
        scales=torch.where(splats.scales < GAUSSIANS["scales"].low, FLAT, splats.scales),
        quats=torch.where(odd & lengths.isfinite(), splats.quats / lengths, splats.quats),
    )


def _faults(splats: Splats) -> Iterator[tuple[Bool[Tensor, " N"], str]]:
    """Which Gaussians cannot be drawn, by the first reason that holds."""
    unturned = (splats.quats.abs() < SMALLEST_QUAT).all(dim=1)
    empty = unturned & ~torch.stack([as_rows(t).any(dim=1) for t in splats.tensors().values()]).any(
        0
    )
    yield empty, "rows of zeros"
    names = {"means": "position", "scales": "size", "quats": "rotation", "opacities": "opacity"}
    for name, declared in GAUSSIANS.items():
        values, what = getattr(splats, name), names.get(name, "colour")
        yield ~as_rows(values).isfinite().all(dim=1), f"whose {what} is not finite"
        yield ~rows_in_range(values, declared), f"whose {what} is out of range"
    yield unturned, "whose rotation is 0"
