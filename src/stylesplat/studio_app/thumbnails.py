"""Small pictures of objects, paintings and style pictures, in grids with words below."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from stylesplat.figures.best_views import close_up
from stylesplat.figures.grid import CARD
from stylesplat.figures.pictures import to_uint8
from stylesplat.rendering.shares import colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats

SIDE = 132  # pixels along a picture
COLUMNS = 3
GAP, CAPTION, FONT_SIZE = 8, 22, 15  # pixels
RIM = (255, 160, 20)  # around what is picked
INK = (225, 226, 230)
LONGEST = 15  # characters of a caption

Thumbnail = UInt8[np.ndarray, "S S 3"]


@torch.no_grad()
def portrait_camera(splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]) -> Cameras:
    """Where an object is seen best, in a small square.

    Raises:
        StyleSplatError: If it shows in no view.
    """
    return close_up(splats, cameras, picked).at_most(SIDE)


@torch.no_grad()
def object_thumbnail(splats: Splats, camera: Cameras, picked: Bool[Tensor, " N"]) -> Thumbnail:
    """An object on a plain card."""
    image, share = colors_and_coverage(splats, camera, picked)
    card = image.new_tensor(CARD) / 255
    return to_uint8(share * image + (1 - share) * card).cpu().numpy()


def picture_thumbnail(picture: Float[Tensor, "H W 3"]) -> Thumbnail:
    """The middle of a picture."""
    pixels = Image.fromarray(to_uint8(picture).numpy())
    side = min(pixels.size)
    left, top = ((length - side) // 2 for length in pixels.size)
    square = pixels.crop((left, top, left + side, top + side))
    return np.array(square.resize((SIDE, SIDE), Image.Resampling.LANCZOS))


def grid(
    pictures: Sequence[Thumbnail], captions: Sequence[str], marked: Sequence[bool] = ()
) -> UInt8[np.ndarray, "H W 4"]:
    """Pictures in rows of three on nothing, those that are marked with a rim.

    Args:
        pictures: At least one.
        captions: One for each.
        marked: Whether each is; none by default.
    """
    lines = -(-len(pictures) // COLUMNS)
    size = (COLUMNS * (SIDE + GAP) - GAP, lines * (SIDE + CAPTION + GAP) - GAP)
    sheet = Image.new("RGBA", size)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(FONT_SIZE)
    for number, (picture, caption) in enumerate(zip(pictures, captions, strict=True)):
        line, column = divmod(number, COLUMNS)
        left, top = column * (SIDE + GAP), line * (SIDE + CAPTION + GAP)
        sheet.paste(Image.fromarray(picture), (left, top))
        if marked and marked[number]:
            draw.rectangle((left, top, left + SIDE - 1, top + SIDE - 1), outline=RIM, width=5)
        draw.text((left + 2, top + SIDE + 2), shortened(caption), INK, font)
    return np.array(sheet)


def shortened(text: str, longest: int = LONGEST) -> str:
    """A text that fits below a picture."""
    return text if len(text) <= longest else f"{text[: longest - 1]}…"
