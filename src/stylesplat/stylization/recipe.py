"""The schema of recipes: which objects are repainted, with what settings."""

from collections.abc import Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError, within
from stylesplat.io.files import read_bytes
from stylesplat.io.kinds import kind_of
from stylesplat.io.layers import RECIPE, Intensity, as_tuple
from stylesplat.io.plain_yaml import INSTEAD, MAX_YAML, parse_yaml
from stylesplat.progress import say
from stylesplat.scene.arguments import check_intensity
from stylesplat.scene.layer import Source
from stylesplat.scene.scene import check_name_or_id
from stylesplat.stylization.config import (
    PRESETS,
    SETTINGS,
    Network,
    Precision,
    StyleConfig,
    convert_settings,
    recolor_config,
    with_settings,
)
from stylesplat.stylization.materials import is_material
from stylesplat.stylization.style import Recipe, RecoloredObject, Style, StyledObject, digest

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
RETIRED = {"canvas", "final_lr", "hard", "max_growth", "pattern", "smoothness", "texture"}
RETIRED |= {"view_dependence", "view_share"}  # settings of older recipes
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
        settings, own, shared = _settings_and_others(content, SHARED)
        config = defaults if defaults and "preset" not in shared else None
        shared = {"preset": preset, **shared}
        config = with_settings(config or PRESETS[shared["preset"]], settings | own)
        objects, recolors, entries = [], [], _named_entries(shared.get("objects"))
        for name, entry in entries:
            with within(name):
                if "recolor" in entry:
                    recolors.append(_recolored_object(name, entry, len(objects), path.parent))
                else:
                    objects.append(_styled_object(name, entry, config, shared, path.parent))
        if shared.get("gone") or any("upon" in entry for _, entry in entries):
            say(
                f"{path} is of an earlier version: which objects it says were there while others "
                "were painted (`gone`, `upon`) is ignored."
            )
    return Recipe(tuple(objects), tuple(recolors))


def parse_variation(text: str) -> tuple[str, tuple[Any, ...]]:
    """A setting, or the preset, and the values it is to take in turn.

    Example:
        >>> parse_variation("layers=[3],[2,3]")
        ('layers', ((3,), (2, 3)))
    """
    key, _, values = text.partition("=")
    if not (key and values.strip()):
        raise StyleSplatError(f"Expected KEY=VALUE,VALUE, got {text!r}. KEY is a setting.")
    with within(f"Cannot vary {text}"):
        values = parse_yaml(f"[{values}]")
        return key, tuple(convert_settings({key: value}, VARIED)[key] for value in values)


def _settings_and_others(
    entry: Mapping[str, Any], keys: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """The settings under `settings`, those of the entry itself, and what it has of `keys`."""
    own = convert_settings(_without_retired(entry), {**SETTINGS, **keys})
    others = {key: own.pop(key) for key in keys if key in own}
    inner = convert_settings(_without_retired(others.get("settings", {})), SETTINGS)
    return inner, own, others


def _without_retired(entry: Mapping[str, Any]) -> dict[str, Any]:
    retired = [key for key in entry if key in RETIRED]
    if retired:
        say(f"{', '.join(retired)}: older recipes have this; it is no setting now and is ignored.")
    return {key: value for key, value in entry.items() if key not in retired}


def _named_entries(objects: dict[str, Any] | list[Any] | None) -> list[tuple[str, dict[str, Any]]]:
    """The entries of `objects` by name, be they a mapping or the list of a recipe.json."""
    if not objects:
        raise StyleSplatError("it names no objects. Add `objects:` with NAME: {style: IMAGE}.")
    if isinstance(objects, list):
        if not all(isinstance(entry, dict) and entry.get("name") for entry in objects):
            raise StyleSplatError("each of the list `objects` must have a name and a style.")
        entries = [dict(entry) for entry in objects]
        pairs = [(str(entry.pop("name")), entry) for entry in entries]
    else:
        pairs = [*objects.items()]
    kinds = [(name, "recolor" in entry) for name, entry in pairs if isinstance(entry, dict)]
    for name, entry in pairs:
        check_name_or_id(name)
        if not isinstance(entry, dict):
            raise StyleSplatError(f"{name} must be KEY: VALUE. Write {name}: {{style: IMAGE}}.")
        if kinds.count((name, "recolor" in entry)) > 1:
            raise StyleSplatError(f"{name} is listed twice. Keep one of them.")
    return pairs


def _styled_object(
    name: str, entry: dict[str, Any], config: StyleConfig, shared: Mapping[str, Any], folder: Path
) -> StyledObject:
    if None in (as_tuple(entry.get("style")) or (None,)):  # colours that were never a file
        entry = {key: value for key, value in entry.items() if key != "style"}
    settings, own, others = _settings_and_others(entry, OWN)
    intensity = own.get("intensity")
    network = shared
    if "features" in others:
        network = others
        own.pop("intensity", None)  # of the recipe of a scene: that of now, not of the painting
    if others.get("form") is not None:
        check_intensity(others["form"], "form")
    pictures = _pictures(as_tuple(others.get("style")), as_tuple(others.get("sha256")), folder)
    config, weights = with_settings(config, settings | own), network.get("weights")
    return StyledObject(
        name=name,
        style=Style(*pictures, config=config, preset=shared["preset"]),
        features=network.get("features"),
        weights=Source(folder / weights, network.get("weights_sha256")) if weights else None,
        intensity=intensity,
        form=others.get("form"),
        precision=others.get("precision"),
    )


def _recolored_object(
    name: str, entry: dict[str, Any], place: int, folder: Path
) -> RecoloredObject:
    own = convert_settings(entry, {"recolor": dict, "intensity": float})
    settings = dict(own["recolor"])
    digests = as_tuple(settings.pop("sha256", None))
    if "match" in settings:
        (settings["match"],) = _pictures((settings["match"],), digests, folder)
    config = recolor_config(settings)
    return RecoloredObject(name, config, own.get("intensity", 1.0), place)


def _pictures(files: tuple[Any, ...], digests: tuple[Any, ...], folder: Path) -> list[Path]:
    if not files:
        raise StyleSplatError(
            "it has no picture. Add `style: IMAGE`."
            if not digests
            else "it was painted with colours that were never a file. Save them, add `style: FILE`."
        )
    pictures = [Path(file) if is_material(file) else folder / file for file in files]
    if digests and len(digests) != len(pictures):
        raise StyleSplatError(f"sha256 must have {len(pictures)} digests, not {len(digests)}.")
    for picture, expected in zip_longest(pictures, digests):
        if is_material(picture):
            digest(picture)  # refuses unknown ones
        elif not picture.is_file():
            raise StyleSplatError(
                f"there is no picture {picture}. Paths are relative to the recipe's folder."
            )
        if expected and digest(picture) != expected:
            raise StyleSplatError(
                f"{picture} is another picture than the recipe's: its digest differs. "
                "Put the picture back, or remove sha256."
            )
    return pictures
