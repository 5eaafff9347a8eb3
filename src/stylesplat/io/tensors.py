"""Tensors on disk: safetensors files, most of them with a row per Gaussian."""

from collections.abc import Mapping
from pathlib import Path

import safetensors
import safetensors.torch
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.declared import Declared, check_tensors
from stylesplat.io.files import atomic_path, read_bytes, reason

REMEDY = "Make the scene again."
# What safetensors raises on headers that lie; types that torch lacks are a KeyError
DAMAGED = (safetensors.SafetensorError, KeyError, TypeError, ValueError, RuntimeError)


def write_tensors(tensors: Mapping[str, Tensor], path: Path) -> None:
    """Write tensors by name, whole or not at all.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    whole = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    with atomic_path(path) as temporary:
        temporary.touch()
        mode = temporary.stat().st_mode  # which safetensors narrows to the owner
        safetensors.torch.save_file(whole, temporary)
        temporary.chmod(mode)


def read_tensors(path: Path, declared: Mapping[str, Declared], **sizes: int) -> dict[str, Tensor]:
    """Read the tensors that a file of its kind has.

    Args:
        path: The file.
        declared: What they have to be.
        sizes: Of letters in their shapes, such as `N`.

    Raises:
        StyleSplatError: If the file is missing or damaged, or holds anything else.
    """
    tensors = _load(path)
    _check(tensors, path, declared, sizes)
    return tensors


def read_named(path: Path, each: Declared, **sizes: int) -> dict[str, Tensor]:
    """Read any number of tensors of one kind, whatever their names.

    Raises:
        StyleSplatError: If the file is missing or damaged, or a tensor is of another kind.
    """
    tensors = _load(path)
    _check(tensors, path, dict.fromkeys(tensors, each), sizes)
    return tensors


def _check(
    tensors: Mapping[str, Tensor],
    path: Path,
    declared: Mapping[str, Declared],
    sizes: Mapping[str, int],
) -> None:
    try:
        check_tensors(tensors, declared, sizes)
    except ValueError as error:
        raise StyleSplatError(f"Cannot read {path}: {error}. {REMEDY}") from error


def _load(path: Path) -> dict[str, Tensor]:
    read_bytes(path, first=1)  # says what is wrong with a place that cannot be read
    try:
        with safetensors.safe_open(path, "pt") as file:
            return {name: file.get_tensor(name).clone() for name in file.keys()}
    except DAMAGED as error:
        raise StyleSplatError(f"Cannot read {path}: {reason(error)}. {REMEDY}") from error
