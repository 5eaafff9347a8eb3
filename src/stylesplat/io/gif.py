"""Animated GIFs: small pictures of 256 colours that play everywhere by themselves."""

from collections.abc import Iterable
from pathlib import Path

from jaxtyping import UInt8
from PIL import Image
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.video import frames_differ
from stylesplat.progress import track

LONGEST_SIDE = 640  # pixels; a GIF of six seconds has some ten megabytes then
FPS = 1000 / 70
STEP, LEAST = 10, 20  # milliseconds: what delays are counted in, and below what browsers slow down
COLORS = 256
SAMPLES = 16  # frames that the colours are chosen from


def write_gif(
    frames: Iterable[UInt8[Tensor, "H W 3"]], path: Path | str, *, fps: float | int = FPS
) -> None:
    """Write a GIF that plays for ever, its sides 640 pixels at most.

    All frames share their 256 colours, or they would flicker.

    Args:
        frames: All of one size.
        path: The file to make.
        fps: Frames per second, of which a GIF knows 50, 33.3, 25, 20, ...

    Raises:
        StyleSplatError: If there are no frames or they differ in size, or the file cannot be
            written.
    """
    pictures = [_small(frame) for frame in frames]
    if not pictures:
        raise StyleSplatError(f"Cannot write {path}: there are no frames. Choose other views.")
    if len({picture.size for picture in pictures}) > 1:
        raise frames_differ(path)
    palette = _palette(pictures)
    counted = track(pictures, "reducing colours", unit="frame")
    first, *others = (picture.quantize(palette=palette) for picture in counted)
    delay = max(LEAST, round(1000 / fps / STEP) * STEP)
    with atomic_path(path) as temporary:
        first.save(temporary, "GIF", save_all=True, append_images=others, duration=delay, loop=0)


def _small(frame: UInt8[Tensor, "H W 3"]) -> Image.Image:
    picture = Image.fromarray(frame.cpu().numpy())
    picture.thumbnail((LONGEST_SIDE, LONGEST_SIDE), Image.Resampling.LANCZOS)
    return picture


def _palette(pictures: list[Image.Image]) -> Image.Image:
    """The colours that some of them have, one below the other."""
    some = pictures[:: -(-len(pictures) // SAMPLES)]
    width, height = some[0].size
    column = Image.new("RGB", (width, height * len(some)))
    for row, picture in enumerate(some):
        column.paste(picture, (0, row * height))
    return column.quantize(COLORS)
