"""Pictures that we make."""

from pathlib import Path

from jaxtyping import Float, Int, UInt8, UInt16
from PIL import Image
from torch import Tensor

from stylesplat.io.files import atomic_path

QUALITY = 95  # of JPEG, with colours at full size: losses are hardly visible
LEVEL = 4  # of PNGs, up to 9: half the time of the usual 6, and files larger by a twentieth

ColorPicture = UInt8[Tensor, "H W 3"] | UInt8[Tensor, "H W 4"]
"""Colours, and alpha if there are four channels, by which colours are not multiplied."""
ViewPicture = ColorPicture | Int[Tensor, "H W"] | UInt16[Tensor, "H W"] | Float[Tensor, "H W"]
"""Colours; ids of labels; or depths, in steps or in world units."""


def write_image(image: ColorPicture, path: Path | str) -> None:
    """Write a picture, whole or not at all, in the format that the suffix names.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    with atomic_path(path) as temporary:
        picture = Image.fromarray(image.cpu().numpy())
        picture.save(temporary, quality=QUALITY, subsampling=0, compress_level=LEVEL)


def write_numbers(numbers: UInt16[Tensor, "H W"] | Float[Tensor, "H W"], path: Path | str) -> None:
    """Write one number a pixel: whole ones as a PNG of 16 bits, others as a TIFF of 32.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    with atomic_path(path) as temporary:
        if numbers.is_floating_point():
            values = Image.fromarray(numbers.float().cpu().numpy())
            values.save(temporary, format="TIFF", compression="tiff_adobe_deflate")
        else:
            Image.fromarray(numbers.cpu().numpy()).save(temporary, format="PNG")
