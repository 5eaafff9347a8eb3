"""Tensors on disk: safetensors files whose names, types, shapes and ranges are declared."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import safetensors
import safetensors.torch
import torch
from jaxtyping import Bool, Shaped
from torch import Tensor

from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import read_bytes, reading
from stylesplat.scene.capture import MAX_ID
from stylesplat.scene.splats import IDENTITY_SIZE
from stylesplat.scene.world_offset import LARGEST_POSITION

TENSOR_REMEDY = "Make the scene again."
# No real splat comes near these, and float32 holds the fourth powers that renders take of them
LARGEST_LOG = 20.0  # of a standard deviation: exp(20) is 5e8
SMALLEST_LOG = -1e4  # flat Gaussians have standard deviations of nearly 0
TENSOR_LARGEST = 1e5  # of a colour, logit, identity or weight


@dataclass(frozen=True)
class Declared:
    """What a tensor of a file has to be."""

    shape: tuple[int | str, ...]
    """Letters are sizes that the tensors of a file share; `N` is the number of Gaussians."""
    dtype: torch.dtype = torch.float32
    low: float | int = -TENSOR_LARGEST
    high: float | int = TENSOR_LARGEST
    unique: bool = False
    optional: bool = False


GAUSSIANS = {
    "means": Declared(("N", 3), low=-LARGEST_POSITION, high=LARGEST_POSITION),
    "quats": Declared(("N", 4)),
    "scales": Declared(("N", 3), low=SMALLEST_LOG, high=LARGEST_LOG),
    "opacities": Declared(("N",)),
    "sh0": Declared(("N", 1, 3)),
    "shN": Declared(("N", "bands", 3)),
}
IDENTITIES = Declared(("N", IDENTITY_SIZE))
TENSOR_CLASSIFIER = {"weight": Declared(("K", IDENTITY_SIZE)), "bias": Declared(("K",))}
CLASSIFIER_IDS = Declared(("K",), torch.int64, low=0, high=MAX_ID, unique=True)
PICKED = Declared(("N",), torch.bool)


def write_tensors(tensors: Mapping[str, Tensor], path: Path) -> None:
    whole, memory = dict[str, Tensor](), set[int]()
    for name, tensor in tensors.items():
        tensor = tensor.detach().cpu().contiguous()
        place = tensor.untyped_storage().data_ptr()
        whole[name] = tensor.clone() if place in memory else tensor  # each has memory of its own
        memory.add(place)
    with atomic_path(path) as draft:
        draft.touch()
        mode = draft.stat().st_mode  # safetensors takes it away from group and others
        safetensors.torch.save_file(whole, draft)
        draft.chmod(mode)


def read_tensors(
    path: Path, declared: Mapping[str, Declared] | Declared, **sizes: int
) -> dict[str, Tensor]:
    """Read the declared tensors of a file, which may hold no others; `sizes` are of letters.

    With one declaration for all, the file may hold any number of tensors of any name.
    """
    read_bytes(path, first=1)  # reports a file that cannot be read
    with reading(path, TENSOR_REMEDY):
        with safetensors.safe_open(path, "pt") as file:
            tensors = {name: file.get_tensor(name).clone() for name in file.keys()}
        if isinstance(declared, Declared):
            declared = dict.fromkeys(tensors, declared)
        check_tensors(tensors, declared, sizes)
    return tensors


def check_tensors(
    tensors: Mapping[str, Tensor], declared: Mapping[str, Declared], sizes: Mapping[str, int]
) -> None:
    """Raise a ValueError unless tensors are as declared; `sizes` are the known ones of letters."""
    missing = [n for n, each in declared.items() if n not in tensors and not each.optional]
    if missing:
        raise ValueError(f"it has no {missing[0]}")
    unknown = next((name for name in tensors if name not in declared), None)
    if unknown is not None:
        raise ValueError(f"it holds {unknown!r:.40}, which is no part of such files")
    known = dict(sizes)
    for name, tensor in tensors.items():
        check_form(name, tensor, declared[name], known)
        check_range(name, tensor, declared[name])


def check_range(name: str, tensor: Tensor, declared: Declared) -> None:
    """Raise a ValueError unless all values of a tensor are finite and in the declared range."""
    if tensor.dtype == torch.bool:
        if (tensor.contiguous().view(torch.uint8) > 1).any():  # torch keeps such bytes as they are
            raise ValueError(f"{name} has values that are neither true nor false")
    elif tensor.numel():
        low, high = tensor.aminmax()  # one pass, enough for nearly every tensor; NaN is in neither
        finite = low > -math.inf and high < math.inf  # the declared range may be infinite
        if not (finite and declared.low <= low and high <= declared.high):
            infinite = int((~tensor.isfinite()).sum()) if tensor.is_floating_point() else 0
            if infinite:
                raise ValueError(f"{infinite} values of {name} are not finite")
            bad = int(((tensor < declared.low) | (tensor > declared.high)).sum())
            bounds = f"{declared.low:g} to {declared.high:g}"
            raise ValueError(f"{bad} values of {name} are out of range, which is {bounds}")
    if declared.unique and len(tensor.unique()) < len(tensor):
        raise ValueError(f"{name} are not all different")


def rows_in_range(tensor: Shaped[Tensor, "N *_"], declared: Declared) -> Bool[Tensor, " N"]:
    """The rows whose values are all in the declared range; NaN is in none."""
    values = as_rows(tensor)
    return ((declared.low <= values) & (values <= declared.high)).all(dim=1)


def as_rows(tensor: Shaped[Tensor, "N *_"]) -> Shaped[Tensor, "N D"]:
    return tensor.reshape(len(tensor), math.prod(tensor.shape[1:]))


def check_form(name: str, tensor: Tensor, declared: Declared, known: dict[str, int]) -> None:
    """Check type and shape; a letter that is not known yet gets the size of this tensor."""
    if tensor.dtype != declared.dtype or tensor.layout != torch.strided:
        expected = str(declared.dtype).removeprefix("torch.")
        raise ValueError(f"{name} is of another type than {expected}")
    shape = [*tensor.shape]
    for size, letter in zip(shape, declared.shape, strict=False):
        if isinstance(letter, str):
            known.setdefault(letter, size)
    expected = [known.get(each, each) if isinstance(each, str) else each for each in declared.shape]
    if shape != expected:
        fault = f"{name} has the shape {shape}, not {expected}"
        if declared.shape[:1] == ("N",) and shape[:1] != expected[:1]:
            fault += f", but there are {known['N']} Gaussians: the files belong to different scenes"
        raise ValueError(fault)
    if tensor.numel() * tensor.itemsize > tensor.untyped_storage().nbytes():
        raise ValueError(f"{name} claims more values than it holds")
