"""Arguments of users: boxes and points in photos, strengths; commands to paste. Loads no torch.

Pixels are those of the photo at its full size, at whatever size it is processed.
"""

import shlex
from collections.abc import Sequence, Sized
from typing import Any, Literal

from stylesplat.errors import StyleSplatError

Places = Sequence[Any]
"""A view's name and its numbers, `("a.jpg", x, y)` or `("a.jpg", (x, y))`; or several of these."""

PickSize = Literal["part", "object", "group"]
"""How much a click picks."""

BOX = "x0, y0, x1, y1"  # in a view
OVERSHOOT = 0.05  # of a side, by which boxes may exceed a photo: `sfm` crops while undistorting


def check_box(
    box: Sequence[float | int], size: tuple[int, int], name: str
) -> tuple[float, float, float, float]:
    """Returns the part of a box inside its photo; refuses an empty box and one far outside."""
    (x0, y0, x1, y1), (width, height) = map(float, box), map(float, size)
    right, below = OVERSHOOT * width, OVERSHOOT * height
    near = -right <= x0 and x1 <= width + right and -below <= y0 and y1 <= height + below
    x0, y0, x1, y1 = max(x0, 0.0), max(y0, 0.0), min(x1, width), min(y1, height)
    if not (near and x0 < x1 and y0 < y1):
        raise StyleSplatError(
            f"Box {','.join(f'{edge:g}' for edge in box)} is empty or reaches outside {name}, "
            f"which is {size[0]}x{size[1]} pixels. Give x0,y0,x1,y1 in pixels of the photo."
        )
    return x0, y0, x1, y1


def check_point(point: tuple[float, float], size: tuple[int, int], name: str) -> None:
    if not all(0 <= value < length for value, length in zip(point, size, strict=True)):
        raise StyleSplatError(
            f"Point {point[0]:g},{point[1]:g} is outside {name}, which is {size[0]}x{size[1]} "
            "pixels. Coordinates are those of the photo at full size."
        )


def parse_places(
    places: Places | None, what: str, *, in_view: str = "", in_world: str = ""
) -> tuple[tuple[str, Any], ...]:
    """Separate views' names, which are empty in the world, and numbers.

    Args:
        places: One place, or several.
        what: The name of the argument, for messages.
        in_view: The numbers of a place in a view, as `x, y` of a point; empty if there is none.
        in_world: Those of a place in the world.

    Example:
        >>> parse_places([("a.jpg", 1, 2), ("b.jpg", (3, 4))], "point", in_view="x, y")
        (('a.jpg', (1.0, 2.0)), ('b.jpg', (3.0, 4.0)))
    """
    parsed = []
    for place in several(places):
        named = isinstance(place, Sequence) and len(place) and isinstance(place[0], str)
        view, numbers = (place[0], place[1:]) if named else ("", place)
        if named and len(numbers) == 1 and isinstance(numbers[0], Sequence):
            (numbers,) = numbers
        try:
            found = tuple(map(float, numbers))
        except (TypeError, ValueError):
            found = ()
        names = in_view if named else in_world
        if not names or len(found) != names.count(",") + 1:
            forms = [f"(view, {in_view})"] if in_view else []
            forms += [f"({in_world})"] if in_world else []
            raise StyleSplatError(f"Cannot use {what}={place!r}. Give {' or '.join(forms)}.")
        parsed.append((view, found))
    return tuple(parsed)


def several(items: Sequence[Any] | None) -> Sequence[Any]:
    """Returns a list of places or shapes where one or several were given."""
    if items is None or not len(items):
        return ()
    alone = isinstance(items[0], str) or not isinstance(items[0], Sized)
    return [items] if alone else items


MAX_INTENSITY = 1.5  # beyond it colours leave their range


def check_intensity(value: float, what: str = "intensity") -> None:
    """Refuse an intensity or form outside of 0 to 1.5."""
    if not 0 <= value <= MAX_INTENSITY:
        raise StyleSplatError(f"Cannot paint with the {what} {value}: use 0 to {MAX_INTENSITY}.")


def pasted(verb: str, *arguments: object) -> str:
    """A command for the shell, its arguments quoted where necessary."""
    return shlex.join(["stylesplat", verb, *map(str, arguments)])
