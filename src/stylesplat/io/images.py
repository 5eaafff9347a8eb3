"""Pictures that we make."""

from pathlib import Path

from jaxtyping import UInt8
from PIL import Image
from torch import Tensor

from stylesplat.io.files import atomic_path


def write_image(image: UInt8[Tensor, "H W 3"], path: Path | str) -> None:
    """Write a picture, whole or not at all, in the format that the suffix names.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    with atomic_path(path) as temporary:
        Image.fromarray(image.cpu().numpy()).save(temporary)
