"""The schema of recipes: which objects are repainted, with what settings."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError, within
from stylesplat.io.files import read_bytes
from stylesplat.io.kinds import kind_of
from stylesplat.io.layers import RECIPE, Intensity, as_tuple
from stylesplat.io.plain_yaml import INSTEAD, MAX_YAML, parse_yaml
from stylesplat.progress import say
from stylesplat.scene.arguments import check_form
from stylesplat.scene.layer import Source
from stylesplat.scene.scene import check_name_or_id
from stylesplat.stylization.config import (
    PRESETS,
    SETTINGS,
    Network,
    Precision,
    StyleConfig,
    convert_settings,
    with_settings,
)
from stylesplat.stylization.style import Recipe, Style, StyledObject, digest

Preset = Literal["default", "paper"]
VARIED = SETTINGS | {"preset": Preset, "stroke_size": SETTINGS["scale"]}  # what a sheet may vary
SHARED = {  # what else a recipe may say of all objects
    "preset": Preset,
    "features": Network | None,
    "weights": str | None,
    "scene": str | None,
    "settings": dict,
    "objects": dict | list | None,
    "gone": list | None,
}
RETIRED = (  # settings of older recipes
    "canvas",
    "final_lr",
    "hard",
    "max_growth",
    "pattern",
    "smoothness",
    "texture",
    "view_dependence",
    "view_share",
)
OWN = {  # and of one
    "style": str | tuple[str, ...],
    "sha256": str | tuple[str, ...] | None,
    "settings": dict,
    "features": Network | None,
    "weights": str | None,
    "weights_sha256": str | None,
    "form": float | None,
    "upon": dict[str, Intensity],
    "precision": Precision | None,
}


@dataclass(frozen=True)
class Base:
    """What the objects of a recipe have in common."""

    config: StyleConfig
    """Settings, which those of an object precede."""
    preset: Preset
    """What these started from."""
    shared: Mapping[str, Any]
    """What else it says of all objects."""
    folder: Path
    """Where it lies."""


@check_arguments
def read_recipe(
    path: Path | str, *, preset: Preset = "default", defaults: StyleConfig | None = None
) -> Recipe:
    """Read a recipe, or the `recipe.json` of a styled scene.

    Settings of an object precede those of the recipe, which precede the preset it names. Paths
    are relative to the recipe's folder.

    Args:
        path: A YAML or JSON file.
        preset: What to start from if the recipe names none.
        defaults: Settings to start from then; by default those of the preset.

    Raises:
        StyleSplatError: If the file is no valid recipe, or a picture is missing or is not the one
            whose digest the recipe holds.
    """
    path = Path(path)
    with within(f"Cannot use the recipe {path}"):
        if path.is_dir() or (kind_of(path) == "part of a scene" and path.name != RECIPE):
            raise StyleSplatError(f"it is no recipe. {INSTEAD}")
        content = parse_yaml(read_bytes(path, most=MAX_YAML))
        if not isinstance(content, dict):
            raise StyleSplatError("it must hold `objects:` and settings, as KEY: VALUE.")
        settings, others = _sorted_out(content, SHARED)
        if "preset" in others:
            preset, defaults = others["preset"], None
        config = with_settings(defaults or PRESETS[preset], settings)
        base = Base(config, preset, others, path.parent)
        objects = []
        for name, entry in _named_entries(others.get("objects")):
            with within(name):
                objects.append(_styled_object(name, entry, base))
        old = any("upon" in entry for _, entry in _named_entries(others.get("objects")))
        if others.get("gone") or old:
            say(
                f"{path} is of an earlier version: which objects it says were there while others "
                "were painted (`gone`, `upon`) is ignored."
            )
    return Recipe(tuple(objects))


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
        return key, tuple(
            convert_settings({key: value}, VARIED)[key] for value in parse_yaml(f"[{values}]")
        )


def _sorted_out(
    entry: Mapping[str, Any], keys: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The settings in an entry, those under `settings` included, and what it has of `keys`."""
    fit = convert_settings(_without_retired(entry), {**SETTINGS, **keys})
    others = {key: fit.pop(key) for key in keys if key in fit}
    return convert_settings(_without_retired(others.get("settings", {})), SETTINGS) | fit, others


def _without_retired(entry: Mapping[str, Any]) -> dict[str, Any]:
    """An entry without settings that older versions had, which the user is told."""
    retired = [key for key in RETIRED if key in entry]
    if retired:
        say(f"{', '.join(retired)}: older recipes have this; it is no setting now and is ignored.")
    return {key: value for key, value in entry.items() if key not in retired}


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
        check_name_or_id(name)
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


def _styled_object(name: str, entry: dict[str, Any], base: Base) -> StyledObject:
    told = (
        convert_settings({"intensity": entry["intensity"]}, SETTINGS)
        if "intensity" in entry
        else {}
    )
    if None in (as_tuple(entry.get("style")) or (None,)):  # colours that were never a file
        entry = {key: value for key, value in entry.items() if key != "style"}
    settings, own = _sorted_out(entry, OWN)
    recorded = "features" in own  # by us, so what is not under `settings` is now
    if recorded:
        settings.pop("intensity", None)
        settings |= {k: v for k, v in own.get("settings", {}).items() if k == "intensity"}
    files, digests = as_tuple(own.get("style")), as_tuple(own.get("sha256"))
    config = with_settings(base.config, settings)
    style = Style(*_pictures(files, digests, base.folder), config=config, preset=base.preset)
    network = own if "features" in own else base.shared
    if own.get("form") is not None:
        check_form(own["form"])
    return StyledObject(
        name=name,
        style=style,
        features=network.get("features"),
        weights=_weights(network, base.folder),
        intensity=told.get("intensity"),
        form=own.get("form"),
        precision=own.get("precision"),
    )


def _pictures(files: tuple[Any, ...], digests: tuple[Any, ...], folder: Path) -> list[Path]:
    if not files:
        raise StyleSplatError(
            "it has no picture. Add `style: IMAGE`."
            if not digests
            else "it was painted with colours that were never a file. Save them, add `style: FILE`."
        )
    pictures = [folder / file for file in files]
    for picture in pictures:
        if not picture.is_file():
            raise StyleSplatError(
                f"there is no picture {picture}. Paths are relative to the recipe's folder."
            )
    if digests and len(digests) != len(pictures):
        raise StyleSplatError(f"sha256 must have {len(pictures)} digests, not {len(digests)}.")
    for picture, expected in zip(pictures, digests, strict=False):
        if digest(picture) != expected:
            raise StyleSplatError(
                f"{picture} is another picture than the recipe's: its digest differs. "
                "Put the picture back, or remove sha256."
            )
    return pictures


def _weights(entry: Mapping[str, Any], folder: Path) -> Source | None:
    """The network's file that an entry names; whoever loads it checks that it is the same."""
    file = entry.get("weights")
    return Source(folder / file, entry.get("weights_sha256")) if file else None
