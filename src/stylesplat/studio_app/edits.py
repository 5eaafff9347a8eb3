"""Edits of the stack of layers: strengths, order, recolourings."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.options import with_settings
from stylesplat.scene.layers import RECOLOR, Blend, Layer, edited, shown_like, split_name
from stylesplat.scene.objects import free_name
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.history import StudioState, require_objects
from stylesplat.stylization.config import (
    DEFAULT_NETWORK,
    RecolorConfig,
    StyleConfig,
    plain_settings,
    without_retired,
)
from stylesplat.stylization.mending import mended_bands
from stylesplat.stylization.style import Style
from stylesplat.verbs.adjust import RECOLOR_BACKGROUND, adjust, recolor

OF_OBJECT = ("region", "guides", "guide_reach")  # settings that are no other layer's
MENDED = "mending/mended"  # the layer of all mending


def find_layer(scene: Scene, name: str) -> Layer:
    """The layer of a name. Raises a StyleSplatError if there is none."""
    layer = scene.layer(name)
    if layer is None:
        raise StyleSplatError(f"{name} is not painted.")
    return layer


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


def solo_layer(state: StudioState, name: str) -> StudioState:
    """Show one layer alone, or the others again as they were."""
    find_layer(state.scene, name)
    if state.solo and state.solo[0] == name:
        before = dict(state.solo[1])
        layers = [replace(e, visible=before.get(e.name, e.visible)) for e in state.scene.layers]
        state, note = replace(state, solo=None), "Showed the other layers again"
    else:
        before = dict(state.solo[1]) if state.solo else {}
        known = {each.name: before.get(each.name, each.visible) for each in state.scene.layers}
        layers = [replace(each, visible=each.name == name) for each in state.scene.layers]
        state, note = replace(state, solo=(name, known)), f"Showed {_what(name)} alone"
    return _with_scene(state, state.scene.with_layers(layers), note)


def set_locked(state: StudioState, name: str, locked: bool) -> StudioState:
    names = state.locked | {name} if locked else state.locked - {name}
    return replace(state, locked=names, note=f"{'Locked' if locked else 'Unlocked'} {_what(name)}")


def set_blend(state: StudioState, name: str, blend: Blend) -> StudioState:
    refuse_locked(state, name)
    layer = replace(find_layer(state.scene, name), blend=blend)
    return replace_layer(state, layer, f"Blend of {_what(name)}: {blend}")


def move_layer(state: StudioState, name: str, to: int) -> StudioState:
    """Move a layer to a place of the stack, counted from the lowest."""
    layer, layers = find_layer(state.scene, name), [*state.scene.layers]
    place = layers.index(layer)
    to = min(max(to, 0), len(layers) - 1)
    if to == place:
        return state
    layers.insert(to, layers.pop(place))
    note = f"Moved {_what(name)} {'up' if to > place else 'down'}"
    return _with_scene(state, state.scene.with_layers(layers), note)


def show_within(
    state: StudioState, name: str, weights: Float[Tensor, " B"], shows: bool
) -> StudioState:
    """Paint a layer's mask in or out, by a brush's weights on the rows of the base."""
    refuse_locked(state, name)
    layer = find_layer(state.scene, name)
    known = layer.whole_mask(len(state.scene.base)).cpu()
    mask = known + (1 - known) * weights if shows else known * (1 - weights)
    if torch.equal(mask[layer.rows], known[layer.rows]):
        raise StyleSplatError(f"The brush did not touch {_what(name)}. Brush over it.")
    note = f"Brushed {_what(name)} {'in' if shows else 'out'}"
    return mask_layer(replace(state, note=note), name, mask)


def mask_by_selection(state: StudioState, name: str) -> StudioState:
    """Show a layer within the selection alone."""
    refuse_locked(state, name)
    if state.selection is None:
        raise StyleSplatError("Nothing is selected. Select where the layer is to show.")
    weights = state.selection.weights / 255
    if not weights[find_layer(state.scene, name).rows].any():
        raise StyleSplatError(f"The selection has nothing of {_what(name)}. Select some of it.")
    note = f"Masked {_what(name)} by the selection"
    return mask_layer(replace(state, note=note), name, weights)


def remove_mask(state: StudioState, name: str) -> StudioState:
    refuse_locked(state, name)
    layer = replace(find_layer(state.scene, name), mask=None)
    return replace_layer(state, layer, f"Removed the mask of {_what(name)}")


def remove_paint(state: StudioState, name: str) -> StudioState:
    refuse_locked(state, name)
    if state.solo and state.solo[0] == name:
        state = solo_layer(state, name)
    scene = adjust(state.scene, objects=name, undo=True)
    return _with_scene(state, scene, f"Removed {_what(name)}")


def recolor_objects(
    state: StudioState, names: Sequence[str], setting: str, value: Any
) -> StudioState:
    """Change one setting of a recolouring; with all at their defaults it is removed."""
    scene = state.scene
    require_objects(scene, {*names} - {RECOLOR_BACKGROUND})
    for name in names:
        own = f"{name}{RECOLOR}"
        refuse_locked(state, own)
        known = scene.layer(own)
        settings = {**(recoloring_of(known) if known else {}), setting: value}
        settings = {k: v for k, v in settings.items() if v != getattr(RecolorConfig, k, None)}
        if settings:
            scene = recolor(scene, name, strength=known.strength if known else 1.0, **settings)
        elif known:
            if state.solo and state.solo[0] == own:
                state = solo_layer(replace(state, scene=scene), own)
                scene = state.scene
            scene = adjust(scene, objects=own, undo=True)
    words = " ".join(value) if isinstance(value, tuple) else str(value or "none")
    words = f"{value:g}" if isinstance(value, float | int) else words or "none"
    note = f"Recoloured {', '.join(names)}: {setting} {words.rpartition('/')[2]}"
    return state if scene is state.scene else _with_scene(state, scene, note)


def recoloring_of(layer: Layer) -> dict[str, Any]:
    match = {"match": str(layer.styles[0].path)} if layer.styles else {}
    return {**layer.settings, **match}


def remove_rows(
    state: StudioState, name: str, weights: Float[Tensor, " B"], note: str
) -> StudioState:
    """Hide Gaussians by a layer, as far as they are removed."""
    rows, base = weights.nonzero()[:, 0], state.scene.base
    layer = split_name(free_name(f"{name}/removed", state.scene.layer))
    bands = base.sh0[rows].cpu(), base.shN[rows].cpu()
    kept = torch.zeros(len(rows))
    return replace_layer(state, edited(*layer, rows, kept, 1 - weights[rows], *bands), note)


def mend(state: StudioState, weights: Float[Tensor, " B"]) -> StudioState:
    """Recolour Gaussians from those around them, by how much a brush touches each.

    All strokes are one layer. They mend what shows with it and below it.
    """
    scene, known = state.scene, state.scene.layer(MENDED)
    refuse_locked(state, MENDED)
    upto = scene if known is None else scene.below(MENDED).with_layer(known)
    rows = weights.nonzero()[:, 0]
    if not len(rows):
        raise StyleSplatError("The brush touched nothing. Brush over the scene.")
    found = mended_bands(upto.splats, upto.to_splats(weights > 0), rows)
    sh0, shN = upto.base.sh0.cpu().clone(), upto.base.shN.cpu().clone()
    shares = torch.zeros(len(sh0))
    if known is not None:
        sh0[known.rows], shN[known.rows], shares[known.rows] = known.sh0, known.shN, known.shares
    before, new = shares[rows], weights[rows]
    both = 1 - (1 - before) * (1 - new)  # of what is below, that is covered after both
    part = (new / both.clamp(min=1e-12))[:, None, None]
    sh0[rows] = torch.lerp(sh0[rows], found[0].cpu(), part)
    shN[rows] = torch.lerp(shN[rows], found[1].cpu(), part)
    shares[rows] = both
    own = shares.nonzero()[:, 0]
    layer = edited(*split_name(MENDED), own, shares[own], torch.ones(len(own)), sh0[own], shN[own])
    if known is not None:
        layer = replace(shown_like(layer, known, len(sh0)), strength=known.strength)
    return replace_layer(state, layer, "Mended with the brush")


def painted_style(layer: Layer, **settings: Any) -> Style:
    """The style of a layer of paint, with some other settings."""
    files = [source.path for source in layer.styles]
    if layer.kind != "paint" or None in files or layer.features != DEFAULT_NETWORK:
        raise StyleSplatError(
            f"{_what(layer.name)[0].upper()}{_what(layer.name)[1:]} cannot be painted again here. "
            "Paint it in another style."
        )
    config = with_settings(StyleConfig(), without_retired(layer.settings))
    return Style(*(file for file in files if file), config=config, **settings)


def _what(name: str) -> str:
    object, label = split_name(name)
    if name.endswith(RECOLOR):
        return f"the recolouring of {object}"
    if name == MENDED:
        return "the mending"
    if label.startswith("removed"):
        return f"the removal of {object}"
    return f"paint {label} of {object}" if label else f"the paint of {object}"


def refuse_locked(state: StudioState, name: str) -> None:
    if name in state.locked:
        raise StyleSplatError(f"The layer of {name} is locked. Unlock it first.")


def replace_layer(state: StudioState, layer: Layer, note: str) -> StudioState:
    """The state with a layer in place of its object's, or on top."""
    return _with_scene(state, state.scene.with_layer(layer), note)


def _with_scene(state: StudioState, scene: Scene, note: str) -> StudioState:
    metrics = {"train": scene.metrics.get("train", {})}  # what was measured is no longer true
    return replace(state, scene=replace(scene, metrics=metrics), note=note)


def describe_settings(settings: Mapping[str, Any]) -> str:
    """The settings of a layer that differ from the defaults."""
    usual = plain_settings(StyleConfig())
    other = {key: value for key, value in settings.items() if value != usual.get(key)}
    if "guides" in other:
        other["guides"] = len(settings["guides"])
    words = (f"{key.replace('_', ' ')} {value}" for key, value in other.items())
    return ", ".join(words) or "usual settings"
