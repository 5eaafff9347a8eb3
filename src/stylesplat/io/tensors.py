"""Tensors on disk: safetensors files, most of them with a row per Gaussian."""

from collections.abc import Mapping
from pathlib import Path

import safetensors
import safetensors.torch
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import atomic_path


def write_tensors(tensors: Mapping[str, Tensor], path: Path) -> None:
    """Write tensors by name, whole or not at all.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    whole = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    with atomic_path(path) as temporary:
        temporary.write_bytes(safetensors.torch.save(whole))


def load_tensors(path: Path) -> dict[str, Tensor]:
    """Read tensors by name.

    Raises:
        StyleSplatError: If the file is missing or damaged.
    """
    try:
        return safetensors.torch.load(path.read_bytes())
    except (OSError, safetensors.SafetensorError) as error:
        raise StyleSplatError(f"Cannot read {path}: {error}. Make the scene again.") from error


def read_rows(path: Path, count: int) -> dict[str, Tensor]:
    """Read tensors that have a row for each of `count` Gaussians.

    Raises:
        StyleSplatError: If the file is missing or damaged, or a tensor has other rows.
    """
    tensors = load_tensors(path)
    check_rows(tensors, path, count)
    return tensors


def check_rows(tensors: Mapping[str, Tensor], path: Path, count: int) -> None:
    """Raise a StyleSplatError if tensors of a file do not have a row per Gaussian."""
    for name, tensor in tensors.items():
        if tensor.shape[:1] != (count,):
            raise StyleSplatError(
                f"Cannot read {path}: {name} has the shape {list(tensor.shape)}, but there are "
                f"{count} Gaussians. The files belong to different scenes."
            )
