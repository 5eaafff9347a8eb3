"""What lies behind a picture: a colour, or nothing."""

import re

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief
from stylesplat.io.images import ColorPicture

Background = tuple[float, float, float] | None
"""A colour in 0..1, or None where the picture is to be transparent."""

BLACK, WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
TRANSPARENT = "transparent"
NAMED: dict[str, Background] = {TRANSPARENT: None, "black": BLACK, "white": WHITE}
HEX = re.compile("#?([0-9a-f]{6})")


def parse_background(text: str) -> Background:
    """The colour that a name or `#rrggbb` stands for.

    Raises:
        StyleSplatError: If it stands for none.

    Example:
        >>> parse_background("#ff0033")
        (1.0, 0.0, 0.2)
    """
    if text.lower() in NAMED:
        return NAMED[text.lower()]
    match = HEX.fullmatch(text.lower())
    if not match:
        raise StyleSplatError(
            f"There is no background {brief(text)!r}. Use {', '.join(NAMED)}, or a colour as "
            "#rrggbb."
        )
    red, green, blue = (byte / 255 for byte in bytes.fromhex(match[1]))
    return red, green, blue


def over(
    image: Float[Tensor, "H W 3"], alpha: Float[Tensor, "H W 1"], background: Background
) -> ColorPicture:
    """A picture on a background; without one, its own colours and how opaque it is.

    Args:
        image: Colours as they are rendered on black.
        alpha: The share of each pixel that is covered.
        background: What is behind.
    """
    if background is not None:
        return to_uint8(image + (1 - alpha) * image.new_tensor(background))
    shown = to_uint8(alpha)
    # By the alpha that is written: so that on black it is the render again
    colors = torch.where(shown > 0, image / (shown / 255).clamp(min=1 / 255), 0)
    return torch.cat([to_uint8(colors), shown], dim=-1)


def to_uint8(image: Float[Tensor, "H W D"]) -> UInt8[Tensor, "H W D"]:
    """An image in 0..1 as bytes; what is out of range is clamped."""
    return (image.clamp(0, 1) * 255).round().to(torch.uint8)
