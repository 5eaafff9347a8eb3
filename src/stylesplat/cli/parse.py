"""Short texts on the command line: places in views and in the world, objects and pictures."""

import math
import re
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import is_file

MOST_PIXELS = 16_384  # along a picture's side


_Place = tuple[str, tuple[float, ...]]
"""A view's name, which is empty in the world, and numbers."""


def parse_point(text: str) -> _Place:
    """A view and a pixel."""
    view, numbers = _split_place(text)
    if not view or len(numbers) != 2:
        raise StyleSplatError(f"Expected VIEW:x,y with pixels of the photo, got {text!r}.")
    return view, numbers


def parse_box(text: str) -> _Place:
    """A view and a rectangle of pixels."""
    view, numbers = _split_place(text)
    if not view or len(numbers) != 4:
        raise StyleSplatError(f"Expected VIEW:x0,y0,x1,y1 with pixels of the photo, got {text!r}.")
    return view, numbers


def parse_named_box(text: str) -> tuple[str, _Place]:
    """An object's name, which may be left out, with a box.

    Example:
        >>> parse_named_box("vase=IMG_0007.jpg:10,20,110,90")
        ('vase', ('IMG_0007.jpg', (10.0, 20.0, 110.0, 90.0)))
    """
    name, place = _split_name(text)
    return name, parse_box(place)


def parse_stroke(text: str) -> tuple[str, str, tuple[tuple[float, float], ...]]:
    """An object's name, which may be left out, a view, and the points of a line.

    Example:
        >>> parse_stroke("vase=IMG_0007.jpg:10,20,110,90")
        ('vase', 'IMG_0007.jpg', ((10.0, 20.0), (110.0, 90.0)))
    """
    name, place = _split_name(text)
    view, numbers = _split_place(place)
    if not view or not numbers or len(numbers) % 2 or not all(map(math.isfinite, numbers)):
        raise StyleSplatError(f"Expected NAME=VIEW:x,y,x,y,... with photo pixels, got {text!r}.")
    return name, view, tuple(zip(numbers[::2], numbers[1::2], strict=True))


def parse_box3d(text: str) -> tuple[float, ...]:
    """Two corners in the world."""
    view, numbers = _split_place(text)
    if view or len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise StyleSplatError(f"Expected x0,y0,z0,x1,y1,z1 in world units, got {text!r}.")
    return numbers


def parse_sphere(text: str) -> _Place:
    """A centre and a radius; the centre in the world, or as the pixel of a view that shows it.

    Example:
        >>> parse_sphere("0,1.5,2,0.5"), parse_sphere("view_003.png:640,400,0.5")
        (('', (0.0, 1.5, 2.0, 0.5)), ('view_003.png', (640.0, 400.0, 0.5)))
    """
    view, numbers = _split_place(text)
    if len(numbers) != (3 if view else 4) or not all(map(math.isfinite, numbers)):
        raise StyleSplatError(
            f"Expected x,y,z,RADIUS in world units, or VIEW:x,y,RADIUS, got {text!r}."
        )
    return view, numbers


def parse_size(text: str) -> tuple[int, int]:
    """A width and a height in pixels."""
    found = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text)
    width, height = map(int, found.groups()) if found else (0, 0)
    if not (2 <= width <= MOST_PIXELS and 2 <= height <= MOST_PIXELS):
        raise StyleSplatError(
            f"Expected WIDTHxHEIGHT in pixels, each 2 to {MOST_PIXELS:,}, got {text!r}."
        )
    return width, height


def parse_style(text: str) -> tuple[str, tuple[Path, ...]]:
    """An object and its style pictures. A comma belongs to a name if there is such a file.

    Example:
        >>> name, images = parse_style("vase=wave.jpg,night.jpg")
        >>> print(name, *images)
        vase wave.jpg night.jpg
    """
    name, _, images = text.partition("=")
    parts = [images] if is_file(images) else images.split(",")
    if not (name and all(parts)):
        raise StyleSplatError(
            f"Expected OBJECT=IMAGE or OBJECT=IMAGE,IMAGE, got {text!r}. "
            "OBJECT is a name that `select` gave, or an id."
        )
    return name, tuple(map(Path, parts))


def _split_name(text: str) -> tuple[str, str]:
    name, equals, place = text.partition("=")
    return (name, place) if equals else ("object", text)


def _split_place(text: str) -> _Place:
    view, _, numbers = text.rpartition(":")
    try:
        return view, tuple(map(float, numbers.split(",")))
    except ValueError:
        return view, ()
