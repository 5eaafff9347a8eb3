"""Small texts on the command line: `VIEW:x,y`, `VIEW:x0,y0,x1,y1` and `OBJECT=IMAGE`."""

from pathlib import Path

from stylesplat.errors import StyleSplatError


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


def parse_style(text: str) -> tuple[str, Path]:
    """An object and a style picture.

    Raises:
        StyleSplatError: If the text is no `OBJECT=IMAGE`.

    Example:
        >>> name, image = parse_style("vase=wave.jpg")
        >>> print(name, image)
        vase wave.jpg
    """
    name, equals, image = text.partition("=")
    if not (name and equals and image):
        raise StyleSplatError(
            f"Expected OBJECT=IMAGE, got {text!r}. OBJECT is a name that `select` gave, or an id."
        )
    return name, Path(image)


def _split_place(text: str) -> tuple[str, list[float]]:
    view, _, numbers = text.rpartition(":")
    try:
        return view, [float(number) for number in numbers.split(",")]
    except ValueError:
        return view, []
