"""The schema of recipes: which objects are repainted, with what settings."""

from collections.abc import Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal

from stylesplat.errors import StyleSplatError, error_context
from stylesplat.io.files import read_bytes
from stylesplat.io.json_yaml import INSTEAD, MAX_YAML, parse_yaml
from stylesplat.io.kinds import kind_of
from stylesplat.io.layers import RECIPE, Intensity, as_tuple
from stylesplat.io.style_pictures import is_material, picture_file
from stylesplat.options import check_arguments, convert_settings, options_of, with_settings
from stylesplat.scene.layers import Blend, Source, check_layer_name
from stylesplat.stylization.config import (
    STYLE_PRESETS,
    Network,
    Precision,
    StyleConfig,
    recolor_config,
    without_retired,
)
from stylesplat.stylization.style import (
    Recipe,
    RecoloredObject,
    StoredLayer,
    Style,
    StyledObject,
    digest,
)

Preset = Literal["default", "paper"]
Strength = Intensity | None  # pyright: ignore[reportOperatorIssue]
STYLE_OPTIONS = options_of(StyleConfig)
# What a sheet may vary
VARIED_KEYS = STYLE_OPTIONS | {"preset": Preset, "stroke_size": STYLE_OPTIONS["scale"]}
RECIPE_KEYS = {  # what else a recipe may say of all objects
    "preset": Preset,
    "features": Network | None,
    "weights": str | None,
    "scene": str | None,
    "settings": dict,
    "objects": dict | list | None,
}
OBJECT_KEYS = {  # and of one
    "style": str | tuple[str | None, ...] | None,
    "sha256": str | tuple[str, ...] | None,
    "settings": dict,
    "features": Network | None,
    "weights": str | None,
    "weights_sha256": str | None,
    "intensity": Strength,
    "form": Strength,
    "precision": Precision | None,
    "blend": Blend,
    "mask": str,
}


@check_arguments
def read_recipe(path: Path | str, *, preset: Preset = "default") -> Recipe:
    """Read a recipe, or the `recipe.json` of a styled scene.

    Settings of an object precede those of the recipe, which precede the preset it names. Paths
    are relative to the recipe's folder.

    Args:
        path: A YAML or JSON file.
        preset: What to start from if the recipe names none.

    Raises:
        StyleSplatError: If the file is no valid recipe, or a picture is missing or is not the one
            whose digest the recipe holds.
    """
    path = Path(path)
    with error_context(f"Cannot use the recipe {path}"):
        if path.is_dir() or (kind_of(path) == "part of a scene" and path.name != RECIPE):
            raise StyleSplatError(f"it is no recipe. {INSTEAD}")
        content = parse_yaml(read_bytes(path, most=MAX_YAML))
        if not isinstance(content, dict):
            raise StyleSplatError("it must hold `objects:` and settings, as KEY: VALUE.")
        settings, shared = _settings_and_others(content, RECIPE_KEYS)
        shared = {"preset": preset, **shared}
        if preset != "default" and shared["preset"] != preset:
            raise StyleSplatError(
                f"it names the preset {shared['preset']}, and {preset} was asked for. Leave one of "
                "them out."
            )
        config = with_settings(STYLE_PRESETS[shared["preset"]], settings)
        objects, recolors = [], []
        for name, entry in _named_entries(shared.get("objects")):
            with error_context(name):
                if "layer" in entry:
                    recolors.append(_stored_layer(name, entry, len(objects), path.parent))
                elif "recolor" in entry:
                    recolors.append(_recolored_object(name, entry, len(objects), path.parent))
                else:
                    objects.append(_styled_object(name, entry, config, shared, path.parent))
    return Recipe(tuple(objects), tuple(recolors))


def parse_variation(text: str) -> tuple[str, tuple[Any, ...]]:
    """A setting, or the preset, and the values it is to take in turn.

    Example:
        >>> parse_variation("region=[0,0,64,64],[9,9,90,90]")
        ('region', ((0, 0, 64, 64), (9, 9, 90, 90)))
    """
    key, _, values = text.partition("=")
    if not (key and values.strip()):
        raise StyleSplatError(f"Expected KEY=VALUE,VALUE, got {text!r}. KEY is a setting.")
    with error_context(f"Cannot vary {text}"):
        values = parse_yaml(f"[{values}]")
        return key, tuple(convert_settings({key: value}, VARIED_KEYS)[key] for value in values)


def _settings_and_others(
    entry: Mapping[str, Any], keys: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The settings of an entry, which precede those under `settings`, and what it has of `keys`."""
    own = convert_settings(without_retired(entry), {**STYLE_OPTIONS, **keys})
    others = {key: own.pop(key) for key in keys if key in own}
    inner = convert_settings(without_retired(others.get("settings", {})), STYLE_OPTIONS)
    return inner | own, others


def _named_entries(objects: dict[str, Any] | list[Any] | None) -> list[tuple[str, dict[str, Any]]]:
    """The entries of `objects` by name, be they a mapping or the list of a recipe.json."""
    if not objects:
        raise StyleSplatError("it names no objects. Add `objects:` with NAME: {style: IMAGE}.")
    if isinstance(objects, dict):
        pairs = [*objects.items()]
    else:
        entries = [dict(entry) if isinstance(entry, dict) else {} for entry in objects]
        pairs = [(str(entry.pop("name", "")), entry) for entry in entries]
    known = set[tuple[str, bool]]()
    for name, entry in pairs:
        check_layer_name(name)
        if not isinstance(entry, dict):
            raise StyleSplatError(f"{name} must be KEY: VALUE. Write {name}: {{style: IMAGE}}.")
        if (name, "recolor" in entry) in known:
            raise StyleSplatError(f"{name} is listed twice. Keep one of them.")
        known.add((name, "recolor" in entry))
    return pairs


def _styled_object(
    name: str, entry: dict[str, Any], config: StyleConfig, shared: Mapping[str, Any], folder: Path
) -> StyledObject:
    settings, own = _settings_and_others(entry, OBJECT_KEYS)
    network = own if "features" in own else shared
    if network is shared and "intensity" in own:  # else that of now, not of the painting
        settings["intensity"] = own["intensity"]
    pictures = _pictures(as_tuple(own.get("style")), as_tuple(own.get("sha256")), folder)
    weights = network.get("weights")
    style = Style(*pictures, config=with_settings(config, settings), preset=shared["preset"])
    return StyledObject(
        name=name,
        style=style,
        features=network.get("features"),
        weights=Source(folder / weights, network.get("weights_sha256")) if weights else None,
        intensity=own.get("intensity"),
        form=own.get("form"),
        precision=own.get("precision"),
        blend=own.get("blend", "normal"),
        mask=folder / own["mask"] if "mask" in own else None,
    )


def _recolored_object(
    name: str, entry: dict[str, Any], place: int, folder: Path
) -> RecoloredObject:
    keys = {"recolor": dict, "intensity": float, "blend": Blend, "mask": str}
    own = convert_settings(entry, keys)
    settings = dict(own["recolor"])
    digests = as_tuple(settings.pop("sha256", None))
    if "match" in settings:
        (settings["match"],) = _pictures((settings["match"],), digests, folder)
    return RecoloredObject(
        name,
        recolor_config(settings),
        own.get("intensity", 1.0),
        place,
        own.get("blend", "normal"),
        folder / own["mask"] if "mask" in own else None,
    )


def _stored_layer(name: str, entry: dict[str, Any], place: int, folder: Path) -> StoredLayer:
    own = convert_settings(entry, {"layer": str, "intensity": float, "blend": Blend})
    file, strength = folder / own["layer"], own.get("intensity", 1.0)
    if not file.is_file():
        raise StyleSplatError(f"there is no file {file} with the layer. Keep it beside the recipe.")
    return StoredLayer(name, file, strength, place, own.get("blend", "normal"))


def _pictures(files: tuple[Any, ...], digests: tuple[Any, ...], folder: Path) -> list[Path]:
    if digests and (not files or None in files):
        raise StyleSplatError(
            "it was painted with colours that were never a file. Save them, add `style: FILE`."
        )
    if not files or None in files:
        raise StyleSplatError("it has no picture. Add `style: IMAGE`.")
    pictures = [Path(file) if is_material(file) else folder / file for file in files]
    if digests and len(digests) != len(pictures):
        raise StyleSplatError(f"sha256 must have {len(pictures)} digests, not {len(digests)}.")
    for picture, expected in zip_longest(pictures, digests):
        if not picture_file(picture).is_file():  # refuses unknown materials
            raise StyleSplatError(
                f"there is no picture {picture}. Paths are relative to the recipe's folder."
            )
        if expected and digest(picture) != expected:
            raise StyleSplatError(
                f"{picture} is another picture than the recipe's: its digest differs. "
                "Put the picture back, or remove sha256."
            )
    return pictures
