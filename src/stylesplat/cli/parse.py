"""Small texts on the command line: `VIEW:x,y`, `VIEW:x0,y0,x1,y1` and `OBJECT=IMAGE`."""

from pathlib import Path

from stylesplat.errors import StyleSplatError


def parse_place(text: str, count: int) -> tuple[str, tuple[float, ...]]:
    """A view's name and `count` pixel coordinates.

    Raises:
        StyleSplatError: If the text is anything else.

    Example:
        >>> parse_place("IMG_0007.jpg:120,45.5", 2)
        ('IMG_0007.jpg', (120.0, 45.5))
    """
    view, _, numbers = text.rpartition(":")
    try:
        place = tuple(float(number) for number in numbers.split(","))
    except ValueError:
        place = ()
    if not view or len(place) != count:
        form = "VIEW:x,y" if count == 2 else "VIEW:x0,y0,x1,y1"
        raise StyleSplatError(f"Expected {form} with pixels of the photo, got {text!r}.")
    return view, place


def parse_style(text: str) -> tuple[str, Path]:
    """An object and a style picture.

    Raises:
        StyleSplatError: If the text is no `OBJECT=IMAGE`.

    Example:
        >>> parse_style("vase=wave.jpg")
        ('vase', PosixPath('wave.jpg'))
    """
    name, equals, image = text.partition("=")
    if not (name and equals and image):
        raise StyleSplatError(
            f"Expected OBJECT=IMAGE, got {text!r}. OBJECT is a name that `select` gave, or an id."
        )
    return name, Path(image)
