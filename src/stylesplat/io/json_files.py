"""JSON as its standard has it, and as the reader of each kind of file declares it."""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import atomic_path

T = TypeVar("T")


def read_json(path: Path | str) -> dict[str, Any]:
    """Read a JSON file that holds an object.

    Raises:
        StyleSplatError: If the file is missing, unreadable or holds anything else.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise StyleSplatError(f"Cannot read {path}: {error.strerror}.") from error
    except (ValueError, RecursionError) as error:
        raise StyleSplatError(f"Cannot read {path}: it is not valid JSON ({error}).") from error
    if not isinstance(content, dict):
        raise StyleSplatError(f"Cannot read {path}: expected a JSON object.")
    return content


def read_json_as(path: Path | str, kind: type[T], remedy: str) -> T:
    """Read a JSON file that holds what a type declares (see msgspec).

    Raises:
        StyleSplatError: If the file is missing, unreadable or holds anything else.
    """
    return fitting(read_json(path), kind, f"Cannot read {path}", remedy)


def fitting(value: Any, kind: Any, what: str, remedy: str) -> Any:
    """A value of a file as a type has it.

    Args:
        value: Plain values.
        kind: A type that msgspec knows, with its bounds.
        what: Begins the message if it does not fit.
        remedy: Ends it.

    Raises:
        StyleSplatError: If it does not fit.
    """
    try:
        return msgspec.convert(value, kind)
    except (msgspec.ValidationError, RecursionError, OverflowError, UnicodeError) as error:
        raise StyleSplatError(f"{what}: {error}. {remedy}") from error


def write_json(content: Mapping[str, Any], path: Path | str) -> None:
    """Write a JSON file; see `strict_json`.

    Raises:
        StyleSplatError: If the disk is full or the place cannot be written to.
    """
    text = strict_json(content, indent=2)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def strict_json(content: Any, *, indent: int | None = None) -> str:
    """JSON as its standard has it: paths become strings, infinities and NaN, which it lacks, null.

    Example:
        >>> strict_json({"psnr": float("inf"), "file": Path("a.ply")})
        '{"psnr": null, "file": "a.ply"}'
    """
    return json.dumps(_strict(content), indent=indent, allow_nan=False, default=os.fspath)


def _strict(value: Any) -> Any:
    if hasattr(value, "tolist"):  # of NumPy or torch
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_strict(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
