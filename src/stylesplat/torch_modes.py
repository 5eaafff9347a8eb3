"""The modes of torch in which verbs compute, whatever modes their callers have set."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

T = TypeVar("T")


@contextmanager
def own_modes() -> Iterator[None]:
    """Gradients can be taken, and new tensors are of float32, within the block."""
    torch = sys.modules.get("torch")
    if torch is None:  # nobody can have set its modes
        yield
        return
    dtype = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        with torch.inference_mode(False), torch.enable_grad():
            yield
    finally:
        torch.set_default_dtype(dtype)


def steps_in_own_modes(steps: Iterator[T]) -> Iterator[T]:
    """The items of an iterator that computes each in `own_modes`; callers keep theirs."""
    while True:
        with own_modes():
            try:
                item = next(steps)
            except StopIteration:
                return
        yield item


def usable(value: T) -> T:
    """A value whose tensors gradients can be taken of: those of inference mode are copied.

    What holds none is returned itself, as verbs tell by identity what has changed.
    """
    return _usable(value)


def _usable(value: Any) -> Any:
    torch = sys.modules.get("torch")
    if torch is None:
        return value
    if isinstance(value, torch.Tensor):
        return value.clone() if value.is_inference() else value
    if isinstance(value, dict):
        found = {key: _usable(each) for key, each in value.items()}
        return found if any(found[key] is not each for key, each in value.items()) else value
    if isinstance(value, list | tuple) and type(value) in (list, tuple):
        items = [_usable(each) for each in value]
        changed = any(new is not old for new, old in zip(items, value, strict=True))
        return type(value)(items) if changed else value
    return _usable_fields(value) if is_dataclass(value) else value


def _usable_fields(value: Any) -> Any:
    changed: Mapping[str, Any] = {
        each.name: found
        for each in fields(value)
        if (found := _usable(old := getattr(value, each.name))) is not old
    }
    if not changed:
        return value
    value = copy(value)  # of a frozen class, whose constructor may take other arguments
    for name, found in changed.items():
        object.__setattr__(value, name, found)
    return value
