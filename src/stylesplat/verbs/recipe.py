"""Recipes: YAML files (or a styled scene's recipe.json) that say how to repaint which object."""

import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, fields, replace
from difflib import get_close_matches
from hashlib import sha256
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import yaml

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import reason
from stylesplat.stylization.config import PRESETS, Network, StyleConfig

TEXT, MERGE, FLOAT = (f"tag:yaml.org,2002:{name}" for name in ("str", "merge", "float"))
TOP_KEYS = {  # besides settings, with their types
    "preset": Literal["default", "paper"],
    "features": Network | None,
    "weights": str | None,
    "scene": str,
    "settings": dict,
    "objects": dict | list | None,
}
OBJECT_KEYS = {"style": str | tuple[str, ...], "sha256": str | tuple[str, ...], "settings": dict}
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


@dataclass(frozen=True)
class StyledObject:
    """One object, what it is to look like, and how to get there."""

    name: str
    """A name that `select` gave, or a label id."""
    styles: tuple[Path, ...]
    """Pictures, all of which exist."""
    config: StyleConfig
    """The recipe's settings with the object's own."""


@dataclass(frozen=True)
class Recipe:
    """What to repaint."""

    objects: tuple[StyledObject, ...]
    """At least one, each once."""
    features: Network | None
    """Network whose features are matched, if the recipe names one."""
    weights: Path | None
    """File of the network's weights, if the recipe names one; it may not exist."""


def read_recipe(path: Path | str, *, defaults: StyleConfig) -> Recipe:
    """Read a recipe.

    Settings of an object precede those of the recipe, which precede the preset it names. Paths
    are relative to the recipe's folder.

    Args:
        path: A YAML or JSON file.
        defaults: Settings to start from if the recipe names no preset.

    Raises:
        StyleSplatError: If the file is no valid recipe, or a picture is missing or is not the one
            whose digest the recipe holds.
    """
    path = Path(path)
    with _within(f"Cannot use the recipe {path}"):
        settings, others = _sorted_out(_load(path), TOP_KEYS)
        base = PRESETS[others["preset"]] if "preset" in others else defaults
        base = replace(base, **settings)
        objects = []
        for name, entry in _named_entries(others.get("objects")):
            with _within(name):
                objects.append(_styled_object(name, entry, base, path.parent))
    weights = path.parent / others["weights"] if others.get("weights") else None
    return Recipe(tuple(objects), others.get("features"), weights)


def named_styles(
    styles: Sequence[tuple[str, tuple[Path, ...]]], recipe: Path | None, *, defaults: StyleConfig
) -> Recipe:
    """The recipe of a file, or of objects and pictures that all have the same settings.

    Raises:
        StyleSplatError: If there are both, a picture is missing, or as `read_recipe` does.
    """
    if recipe is None:
        objects = tuple(StyledObject(name, pictures, defaults) for name, pictures in styles)
        return Recipe(objects, None, None)
    if styles:
        raise StyleSplatError(
            f"Got --style and --recipe. Write {styles[0][0]} into {recipe}, or pass only --style."
        )
    return read_recipe(recipe, defaults=defaults)


def write_recipe(objects: Sequence[StyledObject]) -> dict[str, Any]:
    """The content of a recipe that `read_recipe` reads back, with the pictures' digests."""
    shared = asdict(objects[0].config)
    entries = []
    for each in objects:
        settings = asdict(each.config)
        entries.append(
            {
                "name": each.name,
                "style": _single([path.resolve() for path in each.styles]),
                "sha256": _single([_digest(path) for path in each.styles]),
                "intensity": each.config.intensity,
                "settings": {k: v for k, v in settings.items() if v != shared[k]},
            }
        )
    return {"objects": entries, "settings": shared}


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


@contextmanager
def _within(place: str) -> Iterator[None]:
    """Make errors say where they occurred."""
    try:
        yield
    except StyleSplatError as error:
        raise StyleSplatError(f"{place}: {error}") from error
    except OSError as error:
        raise StyleSplatError(f"{place}: {error.strerror}: {error.filename}.") from error


def _load(path: Path) -> dict[str, Any]:
    try:
        content = yaml.load(path.read_bytes(), _Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else "?"
        raise StyleSplatError(f"line {line} is no valid YAML: {error.problem}.") from error
    except yaml.YAMLError as error:
        raise StyleSplatError(f"it is no YAML text: {reason(error)}.") from error
    if not isinstance(content, dict):
        raise StyleSplatError("it must hold `objects:` and settings, as KEY: VALUE.")
    return content


def _sorted_out(
    entry: dict[str, Any], keys: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The settings in an entry, those under `settings` included, and what it has of `keys`."""
    fit = _fitted(entry, SETTINGS | keys)
    others = {key: fit.pop(key) for key in keys if key in fit}
    return _fitted(others.get("settings", {}), SETTINGS) | fit, others


def _fitted(entry: dict[str, Any], hints: dict[str, Any]) -> dict[str, Any]:
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


def _named_entries(objects: dict[str, Any] | list[Any] | None) -> list[tuple[str, dict[str, Any]]]:
    """The entries of `objects` by name, be they a mapping or the list of a recipe.json."""
    if not objects:
        raise StyleSplatError("it names no objects. Add `objects:` with NAME: {style: IMAGE}.")
    if isinstance(objects, dict):
        pairs = list(objects.items())
    else:
        pairs = [_named_entry(entry) for entry in objects]
    names = set()
    for name, entry in pairs:
        if not isinstance(entry, dict):
            raise StyleSplatError(f"{name} must be KEY: VALUE. Write {name}: {{style: IMAGE}}.")
        if name in names:
            raise StyleSplatError(f"{name} is listed twice. Keep one of them.")
        names.add(name)
    return pairs


def _named_entry(entry: Any) -> tuple[str, dict[str, Any]]:
    if not isinstance(entry, dict) or not entry.get("name"):
        raise StyleSplatError("each of the list `objects` must have a name and a style.")
    return str(entry["name"]), {key: value for key, value in entry.items() if key != "name"}


def _styled_object(
    name: str, entry: dict[str, Any], base: StyleConfig, folder: Path
) -> StyledObject:
    settings, others = _sorted_out(entry, OBJECT_KEYS)
    styles = tuple(folder / style for style in _listed(others.get("style")))
    if not styles:
        raise StyleSplatError("it has no picture. Add `style: IMAGE`.")
    for style in styles:
        if not style.is_file():
            raise StyleSplatError(
                f"there is no picture {style}. Paths are relative to the recipe's folder."
            )
    if "sha256" in others:
        _refuse_changed(styles, _listed(others["sha256"]))
    return StyledObject(name, styles, replace(base, **settings))


def _listed(texts: str | tuple[str, ...] | None) -> tuple[str, ...]:
    return (texts,) if isinstance(texts, str) else texts or ()


def _refuse_changed(styles: tuple[Path, ...], digests: tuple[str, ...]) -> None:
    if len(digests) != len(styles):
        raise StyleSplatError(f"sha256 must have {len(styles)} digests, not {len(digests)}.")
    for style, digest in zip(styles, digests, strict=True):
        if _digest(style) != digest:
            raise StyleSplatError(
                f"{style} is another picture than the recipe's: its digest differs. "
                "Put the picture back, or remove sha256."
            )


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def _single(items: list[Any]) -> Any:
    """The item itself if it is the only one."""
    return items[0] if len(items) == 1 else items
