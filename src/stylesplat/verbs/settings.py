"""Settings as texts: YAML values, checked by the types of `StyleConfig`."""

import json
import math
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields
from difflib import get_close_matches
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import yaml

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import reason
from stylesplat.stylization.style_config import StyleConfig

TEXT, MERGE, FLOAT = (f"tag:yaml.org,2002:{name}" for name in ("str", "merge", "float"))
WORDS = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    str: "text",
    NoneType: "null",
    dict: "KEY: VALUE",
    list: "a list",
}
SETTINGS = {field.name: get_type_hints(StyleConfig)[field.name] for field in fields(StyleConfig)}

VARIED = SETTINGS | {"preset": Literal["default", "paper"]}


@contextmanager
def within(place: str) -> Iterator[None]:
    """Make errors say where they occurred."""
    try:
        yield
    except StyleSplatError as error:
        raise StyleSplatError(f"{place}: {error}") from error
    except OSError as error:
        raise StyleSplatError(f"{place}: {error.strerror}: {error.filename}.") from error


def parse_yaml(text: str | bytes) -> Any:
    """Read YAML or JSON, whose keys become texts.

    Raises:
        StyleSplatError: If it is neither.
    """
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else "?"
        raise StyleSplatError(f"line {line} is no valid YAML: {error.problem}.") from error
    except yaml.YAMLError as error:
        raise StyleSplatError(f"it is no YAML text: {reason(error)}.") from error


def parse_variation(text: str) -> tuple[str, tuple[Any, ...]]:
    """A setting, or the preset, and the values it is to take in turn.

    Raises:
        StyleSplatError: If the text is no `KEY=VALUE,VALUE`, or does not name a setting and what
            it can be.

    Example:
        >>> parse_variation("scale=1,2.5")
        ('scale', (1.0, 2.5))
        >>> parse_variation("layers=[3],[2,3]")
        ('layers', ((3,), (2, 3)))
    """
    key, _, values = text.partition("=")
    if not (key and values.strip()):
        raise StyleSplatError(f"Expected KEY=VALUE,VALUE, got {text!r}. KEY is a setting.")
    with within(f"Cannot vary {text}"):
        return key, tuple(fitted({key: value}, VARIED)[key] for value in parse_yaml(f"[{values}]"))


def fitted(entry: dict[str, Any], hints: dict[str, Any]) -> dict[str, Any]:
    """The values of an entry as their type hints have them.

    Raises:
        StyleSplatError: If a key has no hint, or a value does not fit its own.
    """
    for key in entry:
        if key not in hints:
            raise StyleSplatError(f"there is no key {key!r}. {_suggestion(key, hints)}")
    fit = {}
    for key, value in entry.items():
        try:
            fit[key] = _converted(value, hints[key])
        except (ValueError, OverflowError) as error:
            shown = json.dumps(value, ensure_ascii=False, default=str)
            expected = _described(hints[key])
            raise StyleSplatError(f"{key} must be {expected}, not {shown}.") from error
    return fit


def _converted(value: Any, hint: Any) -> Any:
    """The value as the type hint has it: lists as tuples, whole numbers as floats."""
    kind, arguments = get_origin(hint), get_args(hint)
    if kind in (Union, UnionType):
        for choice in arguments:
            with suppress(ValueError):
                return _converted(value, choice)
    elif kind is tuple and isinstance(value, list):
        hints = arguments[:1] * len(value) if arguments[-1] is ... else arguments
        return tuple(_converted(v, h) for v, h in zip(value, hints, strict=True))
    elif kind is Literal and value in arguments:
        return value
    elif isinstance(value, bool):  # which Python counts among the whole numbers
        if hint is bool:
            return value
    elif hint is float and isinstance(value, int | float) and math.isfinite(value):
        return float(value)
    elif hint is type(value) and hint is not float:
        return value
    raise ValueError


def _described(hint: Any) -> str:
    kind, arguments = get_origin(hint), get_args(hint)
    if kind in (Union, UnionType):
        return " or ".join(map(_described, arguments))
    if kind is Literal:
        return " or ".join(map(json.dumps, arguments))
    if kind is tuple:
        count = "" if arguments[-1] is ... else f" of {len(arguments)}"
        return f"a list{count}, each {_described(arguments[0])}"
    return WORDS[hint]


def _suggestion(key: str, known: Iterable[str]) -> str:
    near = get_close_matches(str(key), known, n=1)
    return f"Did you mean {near[0]!r}?" if near else f"Use one of {', '.join(known)}."


class _Loader(yaml.SafeLoader):
    """YAML whose keys are unique texts, so that `3:` and `no:` are names, and all JSON."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        mapping = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in mapping.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == MERGE:
                continue
            key.tag = TEXT
            if key.value in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"{key.value} is listed twice", problem_mark=key.start_mark
                )
            seen.add(key.value)
        return mapping

    def construct_scalar(self, node: Any) -> str:
        # JSON escapes characters beyond 16 bits as two, which YAML leaves apart
        text = super().construct_scalar(node)
        return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


# JSON's 1e-05, which YAML 1.1 takes for text as it has no point
_Loader.add_implicit_resolver(
    FLOAT, re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)
