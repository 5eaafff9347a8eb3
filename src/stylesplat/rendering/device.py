"""Where to compute."""

import torch

from stylesplat.errors import StyleSplatError


def pick_device(name: torch.device | str = "auto") -> torch.device:
    """The device called `auto`, `cpu` or `cuda`; `auto` takes an NVIDIA GPU where there is one.

    Raises:
        StyleSplatError: If `cuda` is asked for and torch sees no GPU.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    device = torch.device(name)
    if device.type == "cuda" and not torch.cuda.is_available():
        raise StyleSplatError(
            "Cannot compute on cuda: torch sees no NVIDIA GPU here. Use --device cpu, or install "
            "a driver and a CUDA build of torch."
        )
    return device
