"""Where to compute."""

import torch

from stylesplat.errors import StyleSplatError


def pick_device(name: torch.device | str = "auto") -> torch.device:
    """The device called `auto`, `cpu`, `cuda` or `cuda:1`; `auto` is an NVIDIA GPU if there is one.

    Raises:
        StyleSplatError: If it is none of these, or `cuda` is asked for and torch sees no GPU.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except (RuntimeError, TypeError):  # torch's own words for what is no device
        device = None
    if device is None or device.type not in ("cpu", "cuda"):
        raise StyleSplatError(f"There is no device {str(name)!r}. Use auto, cpu or cuda.")
    if device.type == "cuda" and not torch.cuda.is_available():
        raise StyleSplatError(
            "Cannot compute on cuda: torch sees no NVIDIA GPU here. Use --device cpu, or install "
            "a driver and a CUDA build of torch."
        )
    return device
