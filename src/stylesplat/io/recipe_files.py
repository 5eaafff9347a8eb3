"""The stack of layers of a scene as its `recipe.json`, which paints it again."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from msgspec import Meta

from stylesplat.scene.arguments import MAX_INTENSITY
from stylesplat.scene.layer import Layer

RECIPE = "recipe.json"
AGAIN = "Style the scene again."
Word = Annotated[str, Meta(max_length=128, pattern=r"\A[\x20-\x7e]*\Z")]
Intensity = Annotated[float, Meta(ge=0, le=MAX_INTENSITY)]


def recipe_of(layers: Sequence[Layer]) -> dict[str, Any]:
    """The content of `recipe.json`: what was painted, the lowest layer first, and how.

    Settings that the first layer has stand once for all; each object has those that differ. The
    settings are those of the painting; `intensity` and `form` of an object are those of now.
    """
    shared = dict(layers[0].settings)
    return {"objects": [_entry(layer, shared) for layer in layers], "settings": shared}


def listed(values: Any) -> tuple[Any, ...]:
    """What may stand alone or in a list."""
    if values is None:
        return ()
    return tuple(values) if isinstance(values, list | tuple) else (values,)


def _entry(layer: Layer, shared: Mapping[str, Any]) -> dict[str, Any]:
    weights = layer.weights
    entry = {
        "name": layer.object,
        "style": _single([source.path for source in layer.styles]),
        "sha256": _single([source.sha256 for source in layer.styles]),
        "intensity": layer.strength if layer.visible else 0.0,
        "form": layer.form,
        "settings": {k: v for k, v in layer.settings.items() if k not in shared or v != shared[k]},
        "features": layer.features,
        "weights": weights and weights.path,
        "weights_sha256": weights and weights.sha256,
    }
    return entry | ({"precision": layer.precision} if layer.precision else {})


def _single(items: list[Any]) -> Any:
    """The item itself if it is the only one."""
    return items[0] if len(items) == 1 else items
