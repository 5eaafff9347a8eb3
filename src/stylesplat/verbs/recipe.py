"""Recipes: YAML files (or a styled scene's recipe.json) that say how to repaint which object."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from stylesplat.errors import StyleSplatError
from stylesplat.stylization.style_config import PRESETS, Network, StyleConfig
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
    styles: Sequence[tuple[str, tuple[Path, ...]]],
    recipe: Path | None,
    *,
    preset: str,
    settings: dict[str, Any],
) -> Recipe:
    """The recipe of a file, or of objects and pictures that all have the same settings.

    Args:
        styles: Objects and their pictures.
        recipe: The file, if there is one.
        preset: To start from, if the file names none.
        settings: What precedes all that the file says.

    Raises:
        StyleSplatError: If there are both, or as `read_recipe` does.
    """
    defaults = PRESETS[preset]
    if recipe is None:
        config = replace(defaults, **settings)
        objects = tuple(StyledObject(name, pictures, config) for name, pictures in styles)
        return Recipe(objects, None, None)
    if styles:
        raise StyleSplatError(
            f"Got --style and --recipe. Write {styles[0][0]} into {recipe}, or pass only --style."
        )
    found = read_recipe(recipe, defaults=defaults)
    objects = (replace(o, config=replace(o.config, **settings)) for o in found.objects)
    return replace(found, objects=tuple(objects))


def write_recipe(
    objects: Sequence[StyledObject], earlier: dict[str, Any] | None = None
) -> dict[str, Any]:
    """The content of a recipe that `read_recipe` reads back, with the pictures' digests.

    Args:
        objects: What was repainted.
        earlier: The recipe of what was repainted before, which is kept.
    """
    shared, before = _plain(objects[0].config), earlier or {}
    entries = []
    for entry in before.get("objects", []):
        settings = before["settings"] | entry["settings"]
        entries.append({**entry, "settings": _differing(settings, shared)})
    for each in objects:
        entries.append(
            {
                "name": each.name,
                "style": _single([path.resolve() for path in each.styles]),
                "sha256": _single([_digest(path) for path in each.styles]),
                "intensity": each.config.intensity,
                "settings": _differing(_plain(each.config), shared),
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


def _plain(config: StyleConfig) -> dict[str, Any]:
    """Settings as they come back from JSON, which has lists only."""
    return json.loads(json.dumps(asdict(config)))


def _differing(settings: dict[str, Any], shared: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if value != shared[name]}


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def _single(items: list[Any]) -> Any:
    """The item itself if it is the only one."""
    return items[0] if len(items) == 1 else items
