"""Small texts on the command line: places in views and in the world, objects and pictures."""

import math
import re
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import is_file

MOST_PIXELS = 16_384  # along a picture's side


def parse_point(text: str) -> tuple[str, tuple[float, float]]:
    """A view's name and a pixel.

    Raises:
        StyleSplatError: If the text is anything else.

    Example:
        >>> parse_point("IMG_0007.jpg:120,45.5")
        ('IMG_0007.jpg', (120.0, 45.5))
    """
    view, numbers = _split_place(text)
    if not view or len(numbers) != 2:
        raise StyleSplatError(f"Expected VIEW:x,y with pixels of the photo, got {text!r}.")
    x, y = numbers
    return view, (x, y)


def parse_box(text: str) -> tuple[str, tuple[float, float, float, float]]:
    """A view's name and a rectangle of pixels.

    Raises:
        StyleSplatError: If the text is anything else.

    Example:
        >>> parse_box("IMG_0007.jpg:10,20,110,90")
        ('IMG_0007.jpg', (10.0, 20.0, 110.0, 90.0))
    """
    view, numbers = _split_place(text)
    if not view or len(numbers) != 4:
        raise StyleSplatError(f"Expected VIEW:x0,y0,x1,y1 with pixels of the photo, got {text!r}.")
    x0, y0, x1, y1 = numbers
    return view, (x0, y0, x1, y1)


def parse_named_box(text: str) -> tuple[str, str, tuple[float, float, float, float]]:
    """An object's name, a view's, and a rectangle of pixels; the name may be left out.

    Raises:
        StyleSplatError: If the text is anything else.

    Example:
        >>> parse_named_box("vase=IMG_0007.jpg:10,20,110,90")
        ('vase', 'IMG_0007.jpg', (10.0, 20.0, 110.0, 90.0))
    """
    name, place = _split_name(text)
    return name, *parse_box(place)


def parse_stroke(text: str) -> tuple[str, str, tuple[tuple[float, float], ...]]:
    """An object's name, a view's, and the points of a line; the name may be left out.

    Raises:
        StyleSplatError: If the text is anything else.

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
    """Two corners in the world.

    Raises:
        StyleSplatError: If the text is no six numbers.

    Example:
        >>> parse_box3d("-1,0,2,1,0.5,3")
        (-1.0, 0.0, 2.0, 1.0, 0.5, 3.0)
    """
    view, numbers = _split_place(text)
    if view or len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise StyleSplatError(f"Expected x0,y0,z0,x1,y1,z1 in world units, got {text!r}.")
    return tuple(numbers)


def parse_sphere(text: str) -> tuple[str, tuple[float, ...]]:
    """A centre and a radius; the centre in the world, or as the pixel of a view that shows it.

    Raises:
        StyleSplatError: If the text is neither.

    Example:
        >>> parse_sphere("0,1.5,2,0.5"), parse_sphere("view_003.png:640,400,0.5")
        (('', (0.0, 1.5, 2.0, 0.5)), ('view_003.png', (640.0, 400.0, 0.5)))
    """
    view, numbers = _split_place(text)
    if len(numbers) != (3 if view else 4) or not all(map(math.isfinite, numbers)):
        raise StyleSplatError(
            f"Expected x,y,z,RADIUS in world units, or VIEW:x,y,RADIUS, got {text!r}."
        )
    return view, tuple(numbers)


def parse_size(text: str) -> tuple[int, int]:
    """A width and a height in pixels.

    Raises:
        StyleSplatError: If the text is no `WIDTHxHEIGHT`, or one is below 2 or above 16,384.

    Example:
        >>> parse_size("1280x720")
        (1280, 720)
    """
    found = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text)
    width, height = map(int, found.groups()) if found else (0, 0)
    if not (2 <= width <= MOST_PIXELS and 2 <= height <= MOST_PIXELS):
        raise StyleSplatError(
            f"Expected WIDTHxHEIGHT in pixels, each 2 to {MOST_PIXELS:,}, got {text!r}."
        )
    return width, height


def parse_style(text: str) -> tuple[str, tuple[Path, ...]]:
    """An object and its style pictures, one or several.

    A comma belongs to the name if there is such a file.

    Raises:
        StyleSplatError: If the text is no `OBJECT=IMAGE` or `OBJECT=IMAGE,IMAGE`.

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
    return name, tuple(Path(part) for part in parts)


def _split_name(text: str) -> tuple[str, str]:
    """What an object is to be called, and the rest."""
    if "=" not in text:
        return "object", text
    name, _, place = text.partition("=")
    return name, place


def _split_place(text: str) -> tuple[str, list[float]]:
    view, _, numbers = text.rpartition(":")
    try:
        return view, [float(number) for number in numbers.split(",")]
    except ValueError:
        return view, []
