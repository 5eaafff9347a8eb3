"""What was painted on a scene, as its `recipe.json`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import torch
from jaxtyping import Bool
from msgspec import UNSET, Meta, UnsetType
from torch import Tensor

from stylesplat.errors import StyleSplatError, within
from stylesplat.io.json_files import FilePath, fitting, read_json_as
from stylesplat.scene.intensity import MAX_INTENSITY
from stylesplat.scene.paintings import Gone, Painted, Painting, Source
from stylesplat.scene.scene import check_name_or_id

AGAIN = "Style the scene again."
MAX_PLACE = 0xFFFF  # paintings of a scene
Word = Annotated[str, Meta(max_length=128, pattern=r"\A[\x20-\x7e]*\Z")]
Intensity = Annotated[float, Meta(ge=0, le=MAX_INTENSITY)]


class RecipeEntry(msgspec.Struct):
    """One object of a `recipe.json`; those of old lack what has a default."""

    name: str
    style: Any  # one or a list, each declared where they are listed: msgspec 0.22 frees what is
    sha256: Any  # not its own if a text that has bounds or a list may stand in one place
    settings: dict[str, Any]
    intensity: Intensity | None = None
    features: Word | None = None
    weights: FilePath | UnsetType | None = UNSET
    weights_sha256: Word | None = None
    upon: dict[str, Intensity] = {}
    precision: Word | None = None


class GoneEntry(RecipeEntry):
    """One that was taken back, but that others were painted upon."""

    place: Annotated[int, Meta(ge=0, le=MAX_PLACE)] = 0


class RecipeJson(msgspec.Struct):
    """A `recipe.json`; see `recipe_of`."""

    objects: Annotated[tuple[RecipeEntry, ...], Meta(min_length=1)]
    settings: dict[str, Any]
    features: Word | None = None
    weights: FilePath | None = None
    scene: FilePath | None = None
    gone: tuple[GoneEntry, ...] = ()


def recipe_of(painted: Painted) -> dict[str, Any]:
    """The content of `recipe.json`: what was painted, in order, and how.

    Settings that the first painting has stand once for all; each object has those that differ.
    `gone` has paintings that are not there now, with the number of `objects` that are older.
    """
    shared, last = dict(painted.paintings[0].settings), painted.paintings[-1]
    gone = [{**_entry(each.painting, shared), "place": each.place} for each in painted.gone]
    return {
        "objects": [_entry(painting, shared) for painting in painted.paintings],
        "settings": shared,
        "features": last.features,
        "weights": last.weights and last.weights.path,
        "scene": painted.origin,
        **({"gone": gone} if gone else {}),
    }


def read_recipe_json(path: Path) -> RecipeJson:
    """Read the `recipe.json` of a styled scene.

    Raises:
        StyleSplatError: If it is missing, or no such file.
    """
    recipe = read_json_as(path, RecipeJson, AGAIN)
    with within(f"Cannot read {path}"):
        for each in (*recipe.objects, *recipe.gone):
            check_name_or_id(each.name)
    return recipe


def paintings_in(recipe: RecipeJson, rows: Sequence[Bool[Tensor, " N"]]) -> tuple[Painting, ...]:
    """What a `recipe.json` says was painted.

    Args:
        recipe: The file.
        rows: The Gaussians of each object, in its order.

    Raises:
        StyleSplatError: If these are of other objects, or an object lacks something.
    """
    if len(rows) != len(recipe.objects):
        raise StyleSplatError(
            f"it does not say what was painted: it names {len(recipe.objects)} objects, but "
            f"{len(rows)} are known. {AGAIN}"
        )
    pairs = zip(recipe.objects, rows, strict=True)
    return tuple(_painting(entry, recipe, picked) for entry, picked in pairs)


def gone_in(recipe: RecipeJson) -> tuple[Gone, ...]:
    """What a `recipe.json` says was there while others were painted.

    Raises:
        StyleSplatError: If one lacks something.
    """
    nothing = torch.zeros(0, dtype=torch.bool)
    return tuple(Gone(_painting(each, recipe, nothing), each.place) for each in recipe.gone)


def listed(values: Any) -> tuple[Any, ...]:
    """What may stand alone or in a list."""
    if values is None:
        return ()
    return tuple(values) if isinstance(values, list | tuple) else (values,)


def _entry(painting: Painting, shared: Mapping[str, Any]) -> dict[str, Any]:
    weights = painting.weights
    own = {k: v for k, v in painting.settings.items() if k not in shared or v != shared[k]}
    entry = {
        "name": painting.name,
        "style": _single([source.path for source in painting.styles]),
        "sha256": _single([source.sha256 for source in painting.styles]),
        "intensity": painting.intensity,
        "settings": own,
        "features": painting.features,
        "weights": weights and weights.path,
        "weights_sha256": weights and weights.sha256,
    }
    if painting.precision:
        entry["precision"] = painting.precision
    return entry | ({"upon": dict(painting.upon)} if painting.upon else {})


def _painting(entry: RecipeEntry, recipe: RecipeJson, picked: Bool[Tensor, " N"]) -> Painting:
    settings = {**recipe.settings, **entry.settings}
    paths = _several(entry.style, FilePath, f"{entry.name}: style is wrong")
    digests = _several(entry.sha256, Word, f"{entry.name}: sha256 is wrong")
    weights = recipe.weights if entry.weights is UNSET else entry.weights
    features = entry.features or recipe.features
    if len(paths) != len(digests) or not features:
        raise StyleSplatError(
            f"{entry.name} has {len(paths)} styles, {len(digests)} digests and the features "
            f"{features}. {AGAIN}"
        )
    intensity = entry.intensity
    if intensity is None:
        said = settings.get("intensity", 1.0)
        intensity = fitting(said, Intensity, f"{entry.name}: intensity is wrong", AGAIN)
    return Painting(
        name=entry.name,
        picked=picked,
        styles=tuple(
            Source(Path(path) if path else None, digest)
            for path, digest in zip(paths, digests, strict=True)
        ),
        settings=settings,
        intensity=intensity,
        features=features,
        weights=Source(Path(weights), entry.weights_sha256) if weights else None,
        upon=entry.upon,
        precision=entry.precision,
    )


def _several(items: Any, kind: Any, what: str) -> tuple[str | None, ...]:
    """What `_single` was given, each null or of a kind."""
    each = items if isinstance(items, list) else [items]
    return fitting(each, tuple[kind | None, ...], what, AGAIN)


def _single(items: list[Any]) -> Any:
    """The item itself if it is the only one."""
    return items[0] if len(items) == 1 else items
