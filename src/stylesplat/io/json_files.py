"""JSON as its standard defines it, checked against the types that each reader declares."""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.files import read_bytes

T = TypeVar("T")

FilePath = Annotated[str, Meta(max_length=4096, pattern=r"\A[^\x00\ud800-\udc7f\udd00-\udfff]*\Z")]
"""A path that a system can take; Python reads names that are not UTF-8 as \\udc80 to \\udcff."""
MAX_NAME = 1024  # bytes of a photo's name, sub-folders included; systems take 4096 or less
PhotoName = Annotated[
    str, Meta(min_length=1, max_length=MAX_NAME, pattern=r"\A[^\x00-\x1f\x7f\ud800-\udfff]*\Z")
]
"""A name in one line, sub-folders included."""

RESTORE = "Mend it, or copy it again."
MAX_DEPTH = 100  # levels of lists and objects: ours have 6, and writing recurses
MAX_JSON = 2**26  # bytes of a file of a scene: 100,000 cameras
MAX_BYTES = 2**30  # COCO's annotations of 118,000 photos have half of it


def read_json(path: Path | str, *, most: int = MAX_BYTES) -> dict[str, Any]:
    """Read a JSON file of `most` bytes at most that holds an object."""
    return json_object(read_bytes(path, most=most), path)


def json_object(content: bytes, path: Path | str) -> dict[str, Any]:
    """The object in the content of a JSON file; `path` is its name in messages."""
    try:
        found = json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise StyleSplatError(
            f"Cannot read {path}: it is not valid JSON ({error}). {RESTORE}"
        ) from error
    if not isinstance(found, dict):
        raise StyleSplatError(f"Cannot read {path}: expected a JSON object. {RESTORE}")
    level = [found]
    for _ in range(MAX_DEPTH):
        inner = (item for x in level for item in (x.values() if isinstance(x, dict) else x))
        level = [item for item in inner if isinstance(item, dict | list)]
    if level:
        raise StyleSplatError(
            f"Cannot read {path}: it is nested more than {MAX_DEPTH} deep. {RESTORE}"
        )
    return found


def read_json_as(
    path: Path | str, kind: type[T], remedy: str, *, most: int = MAX_JSON, strict: bool = True
) -> T:
    """Read a JSON file as a type of msgspec; see `fitting`."""
    return fitting(read_json(path, most=most), kind, f"Cannot read {path}", remedy, strict=strict)


def fitting(value: Any, kind: Any, what: str, remedy: str, *, strict: bool = True) -> Any:
    """Convert plain values to a type of msgspec; unless `strict`, "3" and 3.0 are integers too.

    The StyleSplatError for a value that does not fit begins with `what` and ends with `remedy`.
    """
    try:
        return msgspec.convert(value, kind, strict=strict)
    except (msgspec.ValidationError, RecursionError, OverflowError, UnicodeError) as error:
        raise StyleSplatError(f"{what}: {error}. {remedy}") from error


def write_json(content: Mapping[str, Any], path: Path | str) -> None:
    text = strict_json(content, indent=2)
    with atomic_path(path) as draft:
        draft.write_text(text + "\n", encoding="utf-8")


def strict_json(content: Any, *, indent: int | None = None) -> str:
    """JSON of the standard: paths become strings; infinities and NaN, which it lacks, null.

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
