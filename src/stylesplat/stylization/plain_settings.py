"""Settings as plain values, such as YAML and JSON have, and back."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields, replace
from difflib import get_close_matches
from typing import Any, get_type_hints

import msgspec

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.style_config import StyleConfig

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
                raise msgspec.ValidationError("Expected a finite `float`")
        except msgspec.ValidationError as error:
            shown = json.dumps(value, ensure_ascii=False, default=str)
            said = str(error)
            raise StyleSplatError(
                f"{key} cannot be {shown}: {said[0].lower()}{said[1:]}. Mend it, or leave it out."
            ) from error
    return fit


def _suggestion(key: str, known: Iterable[str]) -> str:
    near = get_close_matches(str(key), known, n=1)
    return f"Did you mean {near[0]!r}?" if near else f"Use one of {', '.join(known)}."
