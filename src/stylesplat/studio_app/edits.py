"""Edits of the stack of layers: strengths, order, recolourings."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.layers import RECOLOR, Layer
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.history import StudioState
from stylesplat.stylization.config import RecolorConfig, StyleConfig, plain_settings
from stylesplat.verbs.adjust import adjust, recolor


def find_layer(scene: Scene, name: str) -> Layer:
    """The layer of a name. Raises a StyleSplatError if there is none."""
    for layer in scene.layers:
        if layer.name == name:
            return layer
    raise StyleSplatError(f"{name} is not painted.")


def adjust_layer(
    state: StudioState, name: str, strength: float | None = None, form: float | None = None
) -> StudioState:
    refuse_locked(state, name)
    layer = find_layer(state.scene, name)
    if strength in (None, layer.strength) and form in (None, layer.form):
        return state
    what, value = ("Strength", strength) if form is None else ("Form", form)
    scene = adjust(state.scene, strength, form=form, objects=name)
    return replace(state, scene=scene, note=f"{what} of {name}: {value:.0%}")


def mask_layer(state: StudioState, name: str, weights: Float[Tensor, " B"]) -> StudioState:
    """The state with a mask of a layer, for all rows of the base, without another note."""
    layer = find_layer(state.scene, name)
    mask = weights[layer.rows.cpu()]
    layer = replace(layer, mask=None if (mask == 1).all() else mask)
    return replace_layer(state, layer, state.note)


def set_visible(state: StudioState, name: str, visible: bool) -> StudioState:
    layer = replace(find_layer(state.scene, name), visible=visible)
    return replace_layer(state, layer, f"{'Showed' if visible else 'Hid'} {_what(name)}")


def set_locked(state: StudioState, name: str, locked: bool) -> StudioState:
    names = state.locked | {name} if locked else state.locked - {name}
    return replace(state, locked=names, note=f"{'Locked' if locked else 'Unlocked'} {_what(name)}")


def move_layer(state: StudioState, name: str, by: int) -> StudioState:
    layers = [*state.scene.layers]
    place = layers.index(find_layer(state.scene, name))
    to = place + by
    if not 0 <= to < len(layers):
        return state
    layers[place], layers[to] = layers[to], layers[place]
    note = f"Moved {_what(name)} {'up' if by > 0 else 'down'}"
    return _with_scene(state, state.scene.with_layers(layers), note)


def remove_paint(state: StudioState, name: str) -> StudioState:
    refuse_locked(state, name)
    scene = adjust(state.scene, objects=name, undo=True)
    return _with_scene(state, scene, f"Removed {_what(name)}")


def recolor_objects(
    state: StudioState, names: Sequence[str], setting: str, value: Any
) -> StudioState:
    """Change one setting of a recolouring; with all at their defaults it is removed."""
    scene = state.scene
    for name in names:
        own = f"{name}{RECOLOR}"
        refuse_locked(state, own)
        known = next((layer for layer in scene.layers if layer.name == own), None)
        settings = {**(recoloring_of(known) if known else {}), setting: value}
        settings = {k: v for k, v in settings.items() if v != getattr(RecolorConfig, k, None)}
        if settings:
            scene = recolor(scene, name, strength=known.strength if known else 1.0, **settings)
        elif known:
            scene = adjust(scene, objects=own, undo=True)
    words = f"{value:g}" if isinstance(value, float | int) else str(value or "none")
    note = f"Recoloured {', '.join(names)}: {setting} {words.rpartition('/')[2]}"
    return state if scene is state.scene else _with_scene(state, scene, note)


def recoloring_of(layer: Layer) -> dict[str, Any]:
    match = {"match": str(layer.styles[0].path)} if layer.styles else {}
    return {**layer.settings, **match}


def _what(name: str) -> str:
    kind = "recolouring" if name.endswith(RECOLOR) else "paint"
    return f"the {kind} of {name.removesuffix(RECOLOR)}"


def refuse_locked(state: StudioState, name: str) -> None:
    if name in state.locked:
        raise StyleSplatError(f"The layer of {name} is locked. Unlock it first.")


def replace_layer(state: StudioState, layer: Layer, note: str) -> StudioState:
    """The state with a layer in place of its object's, or on top."""
    return _with_scene(state, state.scene.with_layer(layer), note)


def _with_scene(state: StudioState, scene: Scene, note: str) -> StudioState:
    metrics = {"train": scene.metrics.get("train", {})}  # what was measured is no longer true
    return replace(state, scene=replace(scene, metrics=metrics), note=note)


def describe_settings(settings: Mapping[str, object]) -> str:
    """The settings of a layer that differ from the defaults."""
    usual = plain_settings(StyleConfig())
    other = {key: value for key, value in settings.items() if value != usual.get(key)}
    words = (f"{key.replace('_', ' ')} {value}" for key, value in other.items())
    return ", ".join(words) or "usual settings"
