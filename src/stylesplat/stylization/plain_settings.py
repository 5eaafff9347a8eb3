"""Settings as plain values, such as YAML and JSON have, and back."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields, replace
from difflib import get_close_matches
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.style_config import StyleConfig

WORDS = {
    int: "a whole number",
    float: "a number",
    str: "text",
    bool: "true or false",
    NoneType: "null",
    dict: "KEY: VALUE",
    list: "a list",
}
SHOWN = 80  # characters of a value in a message
SETTINGS = {field.name: get_type_hints(StyleConfig)[field.name] for field in fields(StyleConfig)}


def plain(config: StyleConfig) -> dict[str, Any]:
    """Settings as they come back from JSON, which has lists only."""
    return json.loads(json.dumps(asdict(config)))


def with_settings(config: StyleConfig, settings: Mapping[str, Any]) -> StyleConfig:
    """Some settings changed; see `fitted`.

    Raises:
        StyleSplatError: If there is no such setting, or it is out of range.
    """
    return replace(config, **fitted(settings, SETTINGS)) if settings else config


def fitted(entry: Mapping[str, Any], hints: Mapping[str, Any]) -> dict[str, Any]:
    """The values of an entry as their type hints have them: lists as tuples, 2 as 2.0.

    Raises:
        StyleSplatError: If a key has no hint, or a value does not fit its own.
    """
    fit = {}
    for key, value in entry.items():
        if key not in hints:
            raise StyleSplatError(f"there is no key {key!r}. {_suggestion(key, hints)}")
        try:
            fit[key] = msgspec.convert(value, hints[key])
            if isinstance(fit[key], float) and not math.isfinite(fit[key]):
                raise msgspec.ValidationError
        except msgspec.ValidationError as error:
            shown = json.dumps(value, ensure_ascii=False, default=str)
            if len(shown) > SHOWN:
                shown = f"{shown[:SHOWN]}..."
            expected = _described(hints[key])
            raise StyleSplatError(f"{key} must be {expected}, not {shown}.") from error
    return fit


def _described(hint: Any) -> str:
    kind, arguments = get_origin(hint), get_args(hint)
    if kind in (Union, UnionType):
        return " or ".join(map(_described, arguments))
    if kind is Literal:
        return " or ".join(map(json.dumps, arguments))
    if kind is tuple:
        count = "" if arguments[-1] is ... else f" of {len(arguments)}"
        return f"a list{count}, each {_described(arguments[0])}"
    return WORDS[kind or hint]


def _suggestion(key: str, known: Iterable[str]) -> str:
    near = get_close_matches(str(key), known, n=1)
    return f"Did you mean {near[0]!r}?" if near else f"Use one of {', '.join(known)}."
