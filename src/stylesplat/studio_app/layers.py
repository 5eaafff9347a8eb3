"""Changes of the stack of layers: strength, form, order, removal; and the variants of objects."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from stylesplat.errors import StyleSplatError
from stylesplat.scene.compose import with_layers
from stylesplat.scene.layer import Layer
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.history import StudioState
from stylesplat.stylization.config import StyleConfig, plain_settings
from stylesplat.verbs.adjust import adjust


@dataclass(frozen=True)
class Variant:
    """A painting of an object that was finished, or stopped."""

    layer: Layer
    title: str
    thumbnail: bytes
    """A JPEG."""


def find_layer(scene: Scene, name: str) -> Layer:
    """The layer of a name, which is its object's if it is paint.

    Raises:
        StyleSplatError: If it is not painted.
    """
    for layer in scene.layers:
        if layer.name == name:
            return layer
    raise StyleSplatError(f"{name} is not painted.")


def set_strength(state: StudioState, name: str, strength: float) -> StudioState:
    return _adjusted(state, name, "strength", strength)


def set_form(state: StudioState, name: str, form: float) -> StudioState:
    return _adjusted(state, name, "form", form)


def _adjusted(state: StudioState, name: str, what: str, value: float) -> StudioState:
    refuse_locked(state, name)
    if getattr(find_layer(state.scene, name), what) == value:
        return state
    strength, form = (value, None) if what == "strength" else (None, value)
    scene = adjust(state.scene, strength, form=form, objects=name)
    return replace(state, scene=scene, note=f"{what.capitalize()} of {name}: {value:.0%}")


def set_visible(state: StudioState, name: str, visible: bool) -> StudioState:
    layer = replace(find_layer(state.scene, name), visible=visible)
    word = "Showed" if visible else "Hid"
    return _with_layer(state, layer, f"{word} the paint of {name}")


def set_locked(state: StudioState, name: str, locked: bool) -> StudioState:
    find_layer(state.scene, name)
    names = state.locked | {name} if locked else state.locked - {name}
    return replace(state, locked=names, note=f"{'Locked' if locked else 'Unlocked'} {name}")


def move_layer(state: StudioState, name: str, by: int) -> StudioState:
    """Move a layer up or down in the stack."""
    layers = [*state.scene.layers]
    place = layers.index(find_layer(state.scene, name))
    to = place + by
    if not 0 <= to < len(layers):
        return state
    layers[place], layers[to] = layers[to], layers[place]
    word = "up" if by > 0 else "down"
    return _with_scene(state, with_layers(state.scene, layers), f"Moved the paint of {name} {word}")


def remove_paint(state: StudioState, name: str) -> StudioState:
    refuse_locked(state, name)
    scene = adjust(state.scene, objects=name, undo=True)
    return _with_scene(state, scene, f"Removed the paint of {name}")


def use_layer(state: StudioState, layer: Layer, title: str) -> StudioState:
    """Show another painting of an object; all other objects stay as they are."""
    refuse_locked(state, layer.object)
    return _with_layer(state, layer, f"{layer.object}: {title}")


def refuse_locked(state: StudioState, name: str) -> None:
    """Raise a StyleSplatError if an object's paint is locked."""
    if name in state.locked:
        raise StyleSplatError(f"The paint of {name} is locked. Unlock its layer first.")


def _with_layer(state: StudioState, layer: Layer, note: str) -> StudioState:
    """The state with a layer in place of its object's, or on top."""
    scene, others = state.scene, [each.name for each in state.scene.layers]
    layers = [layer if each.name == layer.name else each for each in scene.layers]
    if layer.name not in others:
        layers.append(layer)
    return _with_scene(state, with_layers(scene, layers), note)


def _with_scene(state: StudioState, scene: Scene, note: str) -> StudioState:
    metrics = {"train": scene.metrics.get("train", {})}  # what was measured is no longer true
    return replace(state, scene=replace(scene, metrics=metrics), note=note)


def describe_settings(settings: Mapping[str, object]) -> str:
    """The settings of a painting that differ from the defaults."""
    usual = plain_settings(StyleConfig())
    other = {key: value for key, value in settings.items() if value != usual.get(key)}
    words = (f"{key.replace('_', ' ')} {_word(value)}" for key, value in other.items())
    return ", ".join(words) or "usual settings"


def _word(value: object) -> str:
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
