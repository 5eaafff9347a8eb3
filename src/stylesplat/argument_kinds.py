"""Arguments of the public verbs, checked for their kinds before anything is computed."""

import inspect
import types
from collections.abc import Callable, Sequence
from functools import wraps
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

from stylesplat.errors import StyleSplatError, brief, some

P = ParamSpec("P")
T = TypeVar("T")
WIDER = {Path: PathLike, float: Real, int: Integral}  # what counts as a kind, too
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
    """A verb that raises a StyleSplatError for arguments of other kinds than it declares."""
    parameters = inspect.signature(verb)

    @wraps(verb)
    def checked(*args: P.args, **kwargs: P.kwargs) -> T:
        for name, value in parameters.bind(*args, **kwargs).arguments.items():
            parameter = parameters.parameters[name]
            if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                continue
            if not _fits(value, parameter.annotation):
                _refuse(verb.__name__, name, value, parameter.annotation)
        return verb(*args, **kwargs)

    return checked


def _refuse(verb: str, name: str, value: Any, kind: Any) -> None:
    names = [*dict.fromkeys(_names(kind))]
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


def _fits(value: Any, kind: Any) -> bool:
    """Whether a value is of the kind that an annotation means; items of dicts and lists too."""
    origin, choices = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return any(_fits(value, each) for each in choices)
    if origin is Literal:  # the verb says which there are
        return any(isinstance(value, type(each)) for each in choices)
    if isinstance(kind, TypeVar):
        return any(_fits(value, each) for each in kind.__constraints__) or not kind.__constraints__
    if kind is None:
        return value is None
    kind = getattr(origin or kind, "array_type", origin or kind)  # of jaxtyping
    if kind in (Any, inspect.Parameter.empty) or not isinstance(kind, type):
        return True
    if isinstance(value, str) and kind is Sequence:
        return False  # else its characters would be taken for what it names
    if not isinstance(value, WIDER.get(kind, kind)):
        return False
    if isinstance(value, dict) and len(choices) == 2:
        return all(_fits(each, choices[1]) for each in value.values())
    if isinstance(value, list | tuple) and len(choices) == 1:
        return all(_fits(each, choices[0]) for each in value)
    return True


def _names(kind: Any) -> list[str]:
    """What messages call a kind."""
    origin, choices = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return [name for each in choices for name in _names(each)]
    if origin is Literal:
        return [repr(each) for each in choices]
    if isinstance(kind, TypeVar):
        return [name for each in kind.__constraints__ for name in _names(each)]
    if kind is None or kind is type(None):
        return ["None"]
    return [getattr(getattr(origin or kind, "array_type", origin or kind), "__name__", str(kind))]
