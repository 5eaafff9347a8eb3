"""Arguments of the public verbs, whose types are checked before anything is computed."""

import inspect
import types
from collections.abc import Callable, Iterator, Sequence
from functools import wraps
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

from stylesplat.errors import StyleSplatError, brief, some

P = ParamSpec("P")
T = TypeVar("T")
WIDER = {Path: PathLike, float: Real, int: Integral}  # what is accepted for a type
REMEDIES = {
    "Capture": "`load` reads posed photos from a folder; `sfm` finds the poses of others.",
    "Scene": "`open` reads one from a folder; `train` and `import_` make one.",
    "Splats": "A scene has them as `scene.splats`.",
    "Cameras": "A scene has them as `scene.cameras`.",
    "Style": "Write it as `Style(FILE)`.",
    "Recipe": 'Name the objects, as in {"vase": "wave.jpg"}.',
    "Mapping": "Pass a dictionary.",
}


def check_arguments(verb: Callable[P, T]) -> Callable[P, T]:
    """Make a verb raise a StyleSplatError for arguments of other types than it declares."""
    signature = inspect.signature(verb)

    @wraps(verb)
    def checked(*args: P.args, **kwargs: P.kwargs) -> T:
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            parameter = signature.parameters[name]
            if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                continue
            if not _fits(value, parameter.annotation):
                _refuse(verb.__name__, name, value, parameter.annotation)
        return verb(*args, **kwargs)

    return checked


def _refuse(verb: str, name: str, value: Any, kind: Any) -> None:
    names = [*dict.fromkeys(_name(each) for each in _alternatives(kind))]
    given = type(value).__name__
    if isinstance(value, dict | list | tuple):
        items = value.values() if isinstance(value, dict) else value
        given += f" of {some(dict.fromkeys(type(each).__name__ for each in items))}"
    shown = f", {brief(repr(value))}" if isinstance(value, str | int | float | PathLike) else ""
    remedy = next((REMEDIES[each] for each in reversed(names) if each in REMEDIES), None)
    raise StyleSplatError(
        f"Cannot call {verb} with this `{name}`: it must be {' or '.join(names)}, and is {given}"
        f"{shown}. {remedy or f'`help(stylesplat.{verb})` says what it takes.'}"
    )


def _alternatives(kind: Any) -> Iterator[Any]:
    """The types that an annotation allows, and the values of a Literal."""
    if get_origin(kind) in (Union, types.UnionType, Literal):
        for each in get_args(kind):
            yield from _alternatives(each)
    elif isinstance(kind, TypeVar):
        for each in kind.__constraints__ or (Any,):
            yield from _alternatives(each)
    else:
        yield kind


def _fits(value: Any, kind: Any) -> bool:
    return any(_is_instance(value, each) for each in _alternatives(kind))


def _is_instance(value: Any, kind: Any) -> bool:
    """Whether a value, with the items of a dict or list, is of a type; or of that of a value."""
    plain, items = _plain(kind), get_args(kind)
    if kind in (None, Any, inspect.Parameter.empty):
        return value is None or kind is not None
    if not isinstance(plain, type):  # of a Literal: the verb says which values there are
        return isinstance(value, type(plain)) if isinstance(plain, str | int) else True
    if isinstance(value, str) and plain is Sequence:
        return False  # else its characters would be taken for what it names
    if not isinstance(value, WIDER.get(plain, plain)):
        return False
    if isinstance(value, dict) and len(items) == 2:
        return all(_fits(each, items[1]) for each in value.values())
    if isinstance(value, list | tuple) and len(items) == 1:
        return all(_fits(each, items[0]) for each in value)
    return True


def _plain(kind: Any) -> Any:
    """A type without its parameters; of jaxtyping's, that of the array."""
    plain = get_origin(kind) or kind
    return getattr(plain, "array_type", plain)


def _name(kind: Any) -> str:
    if kind in (None, types.NoneType):
        return "None"
    return repr(kind) if isinstance(kind, str) else getattr(_plain(kind), "__name__", str(kind))
