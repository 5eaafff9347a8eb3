"""What tensors of files have to be: names, types, shapes and ranges, each declared once."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from stylesplat.scene.labels import MAX_ID
from stylesplat.scene.splats import IDENTITY_SIZE

# No real splat comes near these, and float32 holds the fourth powers that renders take of them
LARGEST_PLACE = 1e9  # from the origin; the Earth's radius in metres is 6e6
LARGEST_LOG = 20.0  # of a standard deviation: exp(20) is 5e8
SMALLEST_LOG = -1e4  # flat Gaussians have logarithms of nearly 0
LARGEST = 1e5  # of a colour, logit, identity or weight


@dataclass(frozen=True)
class Declared:
    """One tensor."""

    shape: tuple[int | str, ...]
    """Letters are sizes that tensors of one file share; `N` is the number of Gaussians."""
    dtype: torch.dtype = torch.float32
    """Its type."""
    low: float | int = -LARGEST
    """Of its values, if they are numbers."""
    high: float | int = LARGEST
    """Likewise."""
    unique: bool = False
    """Whether no value occurs twice."""
    optional: bool = False
    """Whether it may be left out."""


GAUSSIANS = {
    "means": Declared(("N", 3), low=-LARGEST_PLACE, high=LARGEST_PLACE),
    "quats": Declared(("N", 4)),
    "scales": Declared(("N", 3), low=SMALLEST_LOG, high=LARGEST_LOG),
    "opacities": Declared(("N",)),
    "sh0": Declared(("N", 1, 3)),
    "shN": Declared(("N", "bands", 3)),
}
IDENTITIES = Declared(("N", IDENTITY_SIZE))
CLASSIFIER = {"weight": Declared(("K", IDENTITY_SIZE)), "bias": Declared(("K",))}
IDS = Declared(("K",), torch.int64, low=0, high=MAX_ID, unique=True)
PICKED = Declared(("N",), torch.bool)


def check_tensors(
    tensors: Mapping[str, Tensor], declared: Mapping[str, Declared], sizes: Mapping[str, int]
) -> None:
    """Check that tensors are what a file of their kind has.

    Args:
        tensors: By name.
        declared: What there is to be, and nothing else.
        sizes: Of letters in shapes, as far as they are known.

    Raises:
        ValueError: If they are not; it says why.
    """
    missing = [n for n, each in declared.items() if n not in tensors and not each.optional]
    if missing:
        raise ValueError(f"it has no {missing[0]}")
    unknown = next((name for name in tensors if name not in declared), None)
    if unknown is not None:
        raise ValueError(f"it holds {unknown!r:.40}, which such files have not")
    known = dict(sizes)
    for name, tensor in tensors.items():
        _check_form(name, tensor, declared[name], known)
        check_range(name, tensor, declared[name])


def check_range(name: str, tensor: Tensor, declared: Declared) -> None:
    """Raise a ValueError unless all values of a tensor are finite and within its bounds."""
    if _fits(tensor, declared):
        return
    if tensor.is_floating_point():
        bad = int((~tensor.isfinite()).sum())
        if bad:
            raise ValueError(f"{bad} values of {name} are not finite")
    if tensor.dtype == torch.bool:
        if (tensor.contiguous().view(torch.uint8) > 1).any():  # torch counts such as what they are
            raise ValueError(f"{name} has values that are neither true nor false")
    else:
        bad = int(((tensor < declared.low) | (tensor > declared.high)).sum())
        if bad:
            bounds = f"{declared.low:g} to {declared.high:g}"
            raise ValueError(f"{bad} values of {name} are out of range, which is {bounds}")
    if declared.unique and len(tensor.unique()) < len(tensor):
        raise ValueError(f"{name} are not all different")


def _fits(tensor: Tensor, declared: Declared) -> bool:
    """Whether one look at the values is enough, as it nearly always is; NaN are in no bounds."""
    if tensor.dtype == torch.bool or declared.unique or not tensor.numel():
        return False
    low, high = tensor.aminmax()
    finite = low > -math.inf and high < math.inf
    return bool(finite and low >= declared.low and high <= declared.high)


def _check_form(name: str, tensor: Tensor, declared: Declared, known: dict[str, int]) -> None:
    """Check type and shape; sizes that were not known are those of this tensor."""
    if tensor.dtype != declared.dtype or tensor.layout != torch.strided:
        expected = str(declared.dtype).removeprefix("torch.")
        raise ValueError(f"{name} is of another type than {expected}")
    shape = [*tensor.shape]
    for size, letter in zip(shape, declared.shape, strict=False):
        if isinstance(letter, str):
            known.setdefault(letter, size)
    expected = [known.get(each, each) if isinstance(each, str) else each for each in declared.shape]
    if shape != expected:
        told = f"{name} has the shape {shape}, not {expected}"
        if declared.shape[:1] == ("N",) and shape[:1] != expected[:1]:
            told += f", but there are {known['N']} Gaussians: the files belong to different scenes"
        raise ValueError(told)
    if tensor.numel() * tensor.itemsize > tensor.untyped_storage().nbytes():
        raise ValueError(f"{name} claims more values than it holds")
