"""Quick checks of types and shapes at every call, in place of jaxtyping's own decorator.

jaxtyping calls two functions that beartype checks, one for the parameters and one for these and
the result, to word its errors better. That takes as long as what is tested. Here beartype checks
the function itself, and what has no array in its signature needs no sizes of axes.
"""

import functools
import inspect
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, get_args, get_type_hints

import jaxtyping
from beartype import beartype
from jaxtyping import AbstractArray, config, jaxtyped

SIZES = jaxtyped("context")  # within, an axis has the same size wherever it is named


def _hints(function: Callable) -> dict[str, Any]:
    """What the parameters and the result are to be, where it is known by now."""
    hints = {}
    for name, hint in function.__annotations__.items():
        try:
            holder = SimpleNamespace(__annotations__={name: hint})
            hints |= get_type_hints(holder, function.__globals__, include_extras=True)
        except NameError:  # imported for type checkers alone, or the class that is being made
            hints[name] = Any
    return hints


def _has_arrays(hint: Any) -> bool:
    """Or classes of our own that may hold some, such as lists, whose items beartype looks at."""
    if isinstance(hint, type) and (
        issubclass(hint, AbstractArray) or hasattr(hint, "__orig_bases__")
    ):
        return True
    arguments = hint if isinstance(hint, list) else get_args(hint)  # `Callable` has a list
    return any(map(_has_arrays, arguments))


def _checked(function: Callable) -> Callable:
    if getattr(function, "__no_type_check__", False):
        return function
    written, hints = function.__annotations__, _hints(function)

    @functools.wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        return function(*args, **kwargs)

    # beartype would check what a generator is given when it starts, among other sizes
    wanted = called if inspect.isgeneratorfunction(function) else function
    function.__annotations__ = hints
    checked = beartype(wanted)
    function.__annotations__ = checked.__annotations__ = written
    if not any(map(_has_arrays, hints.values())):
        return checked

    @functools.wraps(function)
    def with_sizes(*args: Any, **kwargs: Any) -> Any:
        if config.jaxtyping_disable:
            return function(*args, **kwargs)
        with SIZES:
            return checked(*args, **kwargs)

    return with_sizes


def checked(item: Any = None, *, typechecker: object = None) -> Any:
    """What the import hook of jaxtyping calls for each class and function."""
    if item is None:
        return checked
    if isinstance(item, str):  # "context", within which axes keep their sizes
        return jaxtyped("context")
    if inspect.isclass(item):
        init = vars(item).get("__init__")
        if hasattr(item, "__dataclass_fields__") and init and not hasattr(init, "__wrapped__"):
            item.__init__ = _checked(init)
        return item
    if isinstance(item, classmethod | staticmethod):
        return type(item)(_checked(item.__func__))
    if isinstance(item, property):
        get, put, remove = (f and _checked(f) for f in (item.fget, item.fset, item.fdel))
        return property(get, put, remove)
    return _checked(item)


jaxtyping.jaxtyped = checked  # for all that is imported from now on
