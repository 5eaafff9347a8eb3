"""JSON as its standard defines it, and plain YAML, checked against types that readers declare."""

import json
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import msgspec
import yaml
from msgspec import Meta

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import write_file
from stylesplat.io.files import read_bytes, reason

T = TypeVar("T")

FilePath = Annotated[str, Meta(max_length=4096, pattern=r"\A[^\x00\ud800-\udc7f\udd00-\udfff]*\Z")]
"""A path that a system can take; Python reads names that are not UTF-8 as \\udc80 to \\udcff."""
JSON_MAX_NAME = 1024  # bytes of a photo's name, sub-folders included; systems take 4096 or less
PhotoName = Annotated[
    str, Meta(min_length=1, max_length=JSON_MAX_NAME, pattern=r"\A[^\x00-\x1f\x7f\ud800-\udfff]*\Z")
]
"""A name in one line, sub-folders included."""

RESTORE = "Mend it, or copy it again."
JSON_MAX_DEPTH = 100  # levels of lists and objects: ours have 6, and writing recurses
MAX_JSON = 2**26  # bytes of a file of a scene: 100,000 cameras
JSON_MAX_BYTES = 2**30  # COCO's annotations of 118,000 photos have half of it


def read_json(path: Path | str, *, most: int = JSON_MAX_BYTES) -> dict[str, Any]:
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
    for _ in range(JSON_MAX_DEPTH):
        inner = (item for x in level for item in (x.values() if isinstance(x, dict) else x))
        level = [item for item in inner if isinstance(item, dict | list)]
    if level:
        raise StyleSplatError(
            f"Cannot read {path}: it is nested more than {JSON_MAX_DEPTH} deep. {RESTORE}"
        )
    return found


def read_json_as(
    path: Path | str, kind: type[T], remedy: str, *, most: int = MAX_JSON, strict: bool = True
) -> T:
    """Read a JSON file as a type of msgspec; see `convert_checked`."""
    return convert_checked(
        read_json(path, most=most), kind, f"Cannot read {path}", remedy, strict=strict
    )


def convert_checked(value: Any, kind: Any, what: str, remedy: str, *, strict: bool = True) -> Any:
    """Convert plain values to a type of msgspec; unless `strict`, "3" and 3.0 are integers too.

    The StyleSplatError for a value that does not fit begins with `what` and ends with `remedy`.
    """
    try:
        return msgspec.convert(value, kind, strict=strict, str_keys=True)
    except (msgspec.ValidationError, RecursionError, OverflowError, UnicodeError) as error:
        raise StyleSplatError(f"{what}: {error}. {remedy}") from error


def write_json(content: Mapping[str, Any], path: Path | str) -> None:
    text = strict_json(content, indent=2)
    write_file(path, text + "\n")


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


INSTEAD = "Give a YAML file, or the recipe.json of a styled scene."
MAX_YAML = 2**19  # bytes; a recipe of ten objects has 10,000, and a million may take a minute
YAML_DEPTH = 20  # of lists and maps in each other: recipes have 4
MAX_VALUES = 100_000  # those that aliases repeat included
TOO_DEEP = f"lists and maps are nested more than {YAML_DEPTH} deep"

TAGS = NULL, BOOL, INT, FLOAT, *_ = tuple(
    f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str", "seq", "map")
)
MERGE = "tag:yaml.org,2002:merge"
# Scalars without quotes that are no text, by their first character. JSON's 1e-05 is a number,
# unlike in YAML 1.1; dates, hours:minutes, 007 and whole numbers too long for Python are texts
JSON_PLAIN = (
    (NULL, "", ""),
    (NULL, "~|null", "~nN"),
    (BOOL, "(yes|no|true|false|on|off)", "yYnNtTfFoO"),
    (INT, "[-+]?(0|[1-9][0-9_]{0,4000})", "-+0123456789"),
    (FLOAT, r"[-+]?(0|[1-9][0-9]*)(\.[0-9]*)?(e[-+]?[0-9]+)?", "-+0123456789"),
    (FLOAT, r"[-+]?\.([0-9]+(e[-+]?[0-9]+)?|inf|nan)", "-+."),
    (MERGE, "<<", "<"),
)
KeyPath = tuple[str | int, ...]
"""The keys and numbers that lead to a value."""


def parse_yaml(text: str | bytes) -> Any:
    """Read YAML or JSON; keys become texts. Tags and other features without use are refused."""
    return _parse(text)[0]


def lines_of(text: str | bytes) -> dict[KeyPath, int]:
    """The line, from 1, of each key and list item; what an alias repeats has its first line."""
    return _parse(text)[1]


def _parse(text: str | bytes) -> tuple[Any, dict[KeyPath, int]]:
    if len(text) > MAX_YAML:
        raise StyleSplatError(
            f"it is longer than recipes are: {MAX_YAML} bytes at most. Check the name."
        )
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        return (None if node is None else loader.plain(node, ())), loader.lines
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else "?"
        raise StyleSplatError(f"line {line} is no valid YAML: {error.problem}. Mend it.") from error
    except RecursionError as error:
        raise StyleSplatError(f"it is no valid YAML: {TOO_DEEP}. Mend it.") from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # the last of "\\U99999999"
        raise StyleSplatError(f"it is no YAML text: {reason(error)}. {INSTEAD}") from error


class _Loader(yaml.SafeLoader):
    """Keys are unique texts, so that `3:` and `no:` are names; no tags; aliases within bounds."""

    yaml_implicit_resolvers: ClassVar = {}

    def __init__(self, text: str | bytes) -> None:
        super().__init__(text)
        self.lines, self.count = dict[KeyPath, int](), 0

    def plain(self, node: yaml.Node, place: KeyPath) -> Any:
        """The value of a node, and the lines of what is in it."""
        self.count += 1
        if self.count > MAX_VALUES or len(place) > YAML_DEPTH:
            raise _refused(
                TOO_DEEP if len(place) > YAML_DEPTH else "it holds too many values", node
            )
        if node.tag not in TAGS:
            raise _refused("tags such as !name are not for recipes", node)
        if isinstance(node, yaml.SequenceNode):
            found = []
            for number, item in enumerate(node.value):
                self.lines[(*place, number)] = item.start_mark.line + 1
                found.append(self.plain(item, (*place, number)))
            return found
        if isinstance(node, yaml.MappingNode):
            return self._map(node, place)
        return self.construct_object(node)

    def _map(self, node: yaml.MappingNode, place: KeyPath) -> dict[str, Any]:
        own, merged = dict[str, Any](), dict[str, Any]()
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _refused("a key is a list or a map", key)
            if key.tag == MERGE:
                for each in value.value if isinstance(value, yaml.SequenceNode) else [value]:
                    if not isinstance(each, yaml.MappingNode):
                        raise _refused("<< needs a mapping", each)
                    merged = self.plain(each, (*place, key.value)) | merged
                continue
            if key.value in own:
                raise _refused(f"{key.value} is listed twice", key)
            self.lines[(*place, key.value)] = key.start_mark.line + 1
            own[key.value] = self.plain(value, (*place, key.value))
        return merged | own

    def construct_scalar(self, node: Any) -> str:
        # JSON escapes characters beyond 16 bits as two, which YAML leaves apart
        text = super().construct_scalar(node)
        return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def _refused(problem: str, node: yaml.Node) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)


for _tag, _pattern, _first in JSON_PLAIN:
    _Loader.add_implicit_resolver(_tag, re.compile(rf"(?i:{_pattern})\Z"), list(_first) or [""])
