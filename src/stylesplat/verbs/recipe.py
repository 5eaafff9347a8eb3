"""Recipes: YAML files (or a styled scene's recipe.json) that say how to repaint which object."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.config import PRESETS, Network, StyleConfig
from stylesplat.verbs.settings import SETTINGS, fitted, parse_yaml, within

TOP_KEYS = {  # besides settings, with their types
    "preset": Literal["default", "paper"],
    "features": Network | None,
    "weights": str | None,
    "scene": str,
    "settings": dict,
    "objects": dict | list | None,
}
OBJECT_KEYS = {"style": str | tuple[str, ...], "sha256": str | tuple[str, ...], "settings": dict}


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
    with within(f"Cannot use the recipe {path}"):
        settings, others = _sorted_out(_load(path), TOP_KEYS)
        base = PRESETS[others["preset"]] if "preset" in others else defaults
        base = replace(base, **settings)
        objects = []
        for name, entry in _named_entries(others.get("objects")):
            with within(name):
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


def _load(path: Path) -> dict[str, Any]:
    content = parse_yaml(path.read_bytes())
    if not isinstance(content, dict):
        raise StyleSplatError("it must hold `objects:` and settings, as KEY: VALUE.")
    return content


def _sorted_out(
    entry: dict[str, Any], keys: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The settings in an entry, those under `settings` included, and what it has of `keys`."""
    fit = fitted(entry, SETTINGS | keys)
    others = {key: fit.pop(key) for key in keys if key in fit}
    return fitted(others.get("settings", {}), SETTINGS) | fit, others


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
