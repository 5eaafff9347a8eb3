"""Arguments and settings of the public verbs, checked before anything is computed. Loads no torch.

Pixels are those of the photo at its full size, at whatever size it is processed.
"""

import inspect
import json
import types
from collections.abc import Callable, Mapping, Sequence, Sized
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from functools import cache, wraps
from math import isfinite
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    ParamSpec,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec

from stylesplat.errors import StyleSplatError, join_names, shorten
from stylesplat.torch_modes import own_modes, steps_in_own_modes, usable

P = ParamSpec("P")
T = TypeVar("T")
C = TypeVar("C", bound="Config")
WIDER = {Path: PathLike, float: Real, int: Integral}  # what is accepted for a type
REMEDIES = {
    "Capture": "`load` reads posed photos from a folder; `sfm` finds the poses of others.",
    "Scene": "`open` reads one from a folder; `train` and `import_` make one.",
    "Splats": "A scene has them as `scene.splats`.",
    "Cameras": "A scene has them as `scene.cameras`.",
    "Style": "Write it as `Style(FILE)`.",
    "Recipe": 'Name the objects, as in {"vase": "wave.jpg"}.',
}


def check_arguments(verb: Callable[P, T]) -> Callable[P, T]:
    """Make a verb raise a StyleSplatError for arguments of other types than it declares.

    The verb computes in modes of torch of its own.
    """
    signature = inspect.signature(verb)

    @wraps(verb)
    def checked(*args: P.args, **kwargs: P.kwargs) -> T:
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            parameter = signature.parameters[name]
            kinds = _alternatives(parameter.annotation)
            variable = parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
            if not (variable or any(_is_instance(value, each) for each in kinds)):
                _refuse(verb.__name__, name, value, kinds)
        with own_modes():
            result = verb(*usable(args), **usable(kwargs))
        return cast("T", steps_in_own_modes(result)) if inspect.isgenerator(result) else result

    return checked


def _alternatives(kind: Any) -> list[Any]:
    """The types that an annotation allows, and the values of a Literal."""
    if get_origin(kind) in (Union, types.UnionType, Literal):
        return [one for each in get_args(kind) for one in _alternatives(each)]
    if isinstance(kind, TypeVar):
        return [*(kind.__constraints__ or (Any,))]
    return [kind]


def _plain(kind: Any) -> Any:
    """A type without its parameters; of an array type of jaxtyping, the type of the array."""
    plain = get_origin(kind) or kind
    return getattr(plain, "array_type", plain)


def _is_instance(value: Any, kind: Any) -> bool:
    """Whether a value, with the items of a dict or list, is of a type; or of that of a value."""
    plain, items = _plain(kind), get_args(kind)
    if kind is None or kind is Any:
        return value is None or kind is Any
    if not isinstance(plain, type):  # of a Literal: the verb says which values there are
        return isinstance(value, type(plain))
    if isinstance(value, str) and plain is Sequence:
        return False  # else its characters would be taken for what it names
    if isinstance(value, bool) and plain in (int, float):
        return False  # for Python it is 0 or 1
    if not isinstance(value, WIDER.get(plain, plain)):
        return False
    if isinstance(value, dict) and len(items) == 2:
        value, items = value.values(), items[1:]
    elif not (isinstance(value, list | tuple) and items):
        return True
    if len(items) == 1 or items[-1] is ...:
        items = (items[0],) * len(value)
    return len(items) == len(value) and all(
        any(_is_instance(each, kind) for kind in _alternatives(item))
        for each, item in zip(value, items, strict=True)
    )


def _names(kinds: list[Any]) -> list[str]:
    return [
        "None" if each in (None, types.NoneType) else getattr(_plain(each), "__name__", str(each))
        for each in kinds
    ]


def _either(kinds: list[Any]) -> str:
    return " or ".join(dict.fromkeys(_names(kinds)))


def _refuse(verb: str, name: str, value: Any, kinds: list[Any]) -> None:
    given = type(value).__name__
    if isinstance(value, dict | list | tuple):
        items = value.values() if isinstance(value, dict) else value
        given += f" of {join_names(dict.fromkeys(type(each).__name__ for each in items))}"
    elif isinstance(value, str | int | float | PathLike):
        given += f", {shorten(repr(value))}"
    remedies = [REMEDIES[each] for each in reversed(_names(kinds)) if each in REMEDIES]
    remedies.append(f"`help(stylesplat.{verb})` says what it takes.")
    raise StyleSplatError(
        f"Cannot call {verb} with this `{name}`: it must be {_either(kinds)}, "
        f"and is {given}. {remedies[0]}"
    )


@dataclass(frozen=True)
class Option:
    """What a field of a config allows, and where it is offered: `Annotated[float, Option(0, 4)]`.

    The field has its default and under it its help. Everything that offers it reads it here.
    """

    low: float | int | None = None
    high: float | int | None = None
    name: str | None = None
    """On the command line, where that is not the field's."""
    label: str = ""
    """In the studio, which offers only what has one."""
    slider: tuple[float | int, float | int] = (0.0, 1.0)
    """In the studio."""
    step: float | int = 0.05
    """Of the slider."""
    research: bool = False
    """Whether `from_config` leaves it out: it is for Python and recipes."""
    kind: Any = Any
    default: Any = None

    @property
    def choices(self) -> tuple[Any, ...]:
        """The only values that it takes; empty if it takes others too."""
        return get_args(self.kind) if get_origin(self.kind) is Literal else ()

    def convert(self, value: Any) -> Any:
        """The value in its type: 2 as 2.0, a list as a tuple.

        Raises:
            ValueError: With the remedy, if it is of another type, or beyond the range.
        """
        value, kinds = tuple(value) if isinstance(value, list) else value, _alternatives(self.kind)
        fits = any(_is_instance(value, each) for each in kinds)
        if not fits or (self.choices and value not in self.choices):
            raise ValueError(f"it must be {_either(kinds)}")
        if value is None or self.low is None:
            return value
        if not self.low <= value <= cast("float", self.high):
            raise ValueError(f"use {self.low:,} to {self.high:,}")
        return float(value) if float in kinds else int(value)


MANY = 10**9  # what lies beyond is a slip of the keyboard
Seed = Annotated[int, Option(-(10**18), 10**18)]  # torch takes somewhat larger ones


@cache
def options_of(config: type) -> dict[str, Option]:
    """The options that the fields of a config declare, by name."""
    hints, declared = get_type_hints(config), get_type_hints(config, include_extras=True)
    found = {}
    for each in fields(config):
        known = getattr(declared[each.name], "__metadata__", (Option(),))[0]
        found[each.name] = replace(known, kind=hints[each.name], default=each.default)
    return found


@dataclass(frozen=True)
class Config:
    """The base of dataclasses of settings, whose values are checked."""

    verb: ClassVar[str]
    """What the settings are for, in messages."""

    def __post_init__(self) -> None:
        self.convert(vars(self))

    def convert(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Settings in their types; refuses others, and those beyond their range."""
        options, found = options_of(type(self)), {}
        _refuse_unknown(settings, options)
        for name, value in settings.items():
            try:
                found[name] = options[name].convert(value)
            except ValueError as fault:
                shown = shorten(repr(value))
                raise StyleSplatError(f"Cannot {self.verb} with {name} {shown}: {fault}.") from None
        return found


def with_settings(config: C, settings: Mapping[str, Any]) -> C:
    """The config with some settings changed, which are converted to their types."""
    return replace(config, **config.convert(settings))


def convert_settings(entry: Mapping[str, Any], hints: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the values of an entry of a file to their types, or as options allow."""
    _refuse_unknown(entry, hints)
    fit = {}
    for key, value in entry.items():
        hint = hints[key]
        try:
            is_option = isinstance(hint, Option)
            fit[key] = hint.convert(value) if is_option else msgspec.convert(value, hint)
        except (ValueError, msgspec.ValidationError) as error:
            literals = [each for each in (hint, *get_args(hint)) if get_origin(each) is Literal]
            choices = [word for each in literals for word in get_args(each)]
            fault = f"it must be {' or '.join(choices)}" if choices else str(error)
            shown = shorten(json.dumps(value, ensure_ascii=False, default=str))
            raise StyleSplatError(f"{key} cannot be {shown}: {fault}.") from error
    return fit


def _refuse_unknown(entry: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    for key in entry:
        if key not in known:
            near = get_close_matches(str(key), known, n=1)
            remedy = f"Did you mean {near[0]!r}?" if near else f"Use one of {', '.join(known)}."
            raise StyleSplatError(f"there is no key {key!r}. {remedy}")


PickSize = Literal["part", "object", "group"]
"""How much a click picks."""

Places = Sequence[Any]
"""A view's name and its numbers, `("a.jpg", x, y)` or `("a.jpg", (x, y))`; or several of these."""

Place = tuple[str, Any]
"""A view's name, which is empty in the world, and numbers."""


@dataclass(frozen=True)
class PlaceForm:
    """How a place is written: `VIEW:x,y` on the command line, `(view, x, y)` in Python.

    Example:
        >>> POINT.parse("a.jpg:1,2"), POINT.parse(("a.jpg", 1, 2))
        (('a.jpg', (1.0, 2.0)), ('a.jpg', (1.0, 2.0)))
    """

    in_view: str = ""
    """The numbers of a place in a view, pixels of the photo; with dots any number of pairs."""
    in_world: str = ""
    """Those of a place in the world; empty if there is none."""

    def parse(self, place: Any, what: str = "") -> Place:
        """The name of the view and the numbers; refuses others, of the argument `what`."""
        if isinstance(place, str):
            view, _, text = place.rpartition(":")
            numbers = text.split(",")
        else:
            named = isinstance(place, Sequence) and len(place) and isinstance(place[0], str)
            view, numbers = (place[0], place[1:]) if named else ("", place)
            if named and len(numbers) == 1 and isinstance(numbers[0], Sequence):
                (numbers,) = numbers
        try:
            found = tuple(map(float, numbers))
        except (TypeError, ValueError):
            found = ()
        names = self.in_view if view else self.in_world
        is_line = names.endswith("...") and found and len(found) % 2 == 0
        if names and all(map(isfinite, found)) and (is_line or len(found) == names.count(",") + 1):
            return view, found
        forms = [each for each in (self.in_world, self.in_view and f"VIEW:{self.in_view}") if each]
        if isinstance(place, str):
            raise StyleSplatError(f"Expected {' or '.join(forms)}, got {place!r}.")
        forms = [f"({each.replace(':', ',').replace(',', ', ').lower()})" for each in forms]
        raise StyleSplatError(f"Cannot use {what}={place!r}. Give {' or '.join(forms)}.")

    def parse_all(self, places: Places | None, what: str) -> tuple[Place, ...]:
        """The places that one or several stand for."""
        if places is None or not len(places):
            return ()
        texts = not isinstance(places, str) and all(isinstance(each, str) for each in places)
        alone = not texts and (isinstance(places[0], str) or not isinstance(places[0], Sized))
        return tuple(self.parse(each, what) for each in ([places] if alone else places))


POINT, BOX = PlaceForm("x,y"), PlaceForm("x0,y0,x1,y1")
LINE = PlaceForm("x,y,x,y,...")
BOX3D = PlaceForm(in_world="x0,y0,z0,x1,y1,z1")
SPHERE = PlaceForm("x,y,RADIUS", "x,y,z,RADIUS")
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
    """Refuse a point outside of a view of that size."""
    if not all(0 <= value < length for value, length in zip(point, size, strict=True)):
        raise StyleSplatError(
            f"Point {point[0]:g},{point[1]:g} is outside {name}, which is {size[0]}x{size[1]} "
            "pixels. Coordinates are those of the photo at full size."
        )


MAX_INTENSITY = 1.5  # beyond it colours leave their range


def check_intensity(value: float, what: str = "intensity") -> None:
    """Refuse an intensity or form outside of 0 to 1.5."""
    if not 0 <= value <= MAX_INTENSITY:
        raise StyleSplatError(f"Cannot paint with the {what} {value}: use 0 to {MAX_INTENSITY}.")
