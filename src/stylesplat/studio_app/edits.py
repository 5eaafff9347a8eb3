"""Edits of the studio: picked objects, and the stack of layers with its strengths and order."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import torch
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.hub import is_at_hand
from stylesplat.options import PickSize
from stylesplat.rendering.weights import pixels_in
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import RECOLOR, Layer
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import IN_MEMORY, Selection
from stylesplat.scene.world_offset import to_world
from stylesplat.selection.resolve import find_object, resolve_selection
from stylesplat.selection.shapes import grow, grow_by_similarity, surface_point, within_distance
from stylesplat.selection.surface_cut import pick_clicked
from stylesplat.selection.surface_graph import NothingToPick
from stylesplat.selection.text import CHECKPOINT
from stylesplat.studio_app.history import StudioState, replace_scene, require_picked
from stylesplat.studio_app.messages import How, PicturePoint, Shape, ViewVector
from stylesplat.stylization.config import RecolorConfig, StyleConfig, plain_settings
from stylesplat.verbs.adjust import adjust, recolor
from stylesplat.verbs.objects import delete, rename


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


MADE = "object {}"  # names of picks that are made by shapes
BENEATH = 0.1  # of what shows: how deep what is beneath belongs to it
SEEDS = 25  # of the reach, within which what is around a click belongs to it whatever its look
LEAST_SHOWN = 0.05  # of a pixel, by which a Gaussian shows
DECIMALS = 5  # of places in the world that `objects.json` records


def pick_names(state: StudioState, names: Sequence[str], how: How = "new") -> StudioState:
    if how == "away":
        picked = tuple(name for name in state.picked if name not in names)
    else:
        before = state.picked if how == "add" else ()
        picked = tuple(dict.fromkeys((*before, *names)))
    return replace(state, picked=picked, note=f"Picked {', '.join(picked) or 'nothing'}")


def pick_ball(
    state: StudioState, camera: Cameras, place: PicturePoint, radius: float, how: How = "new"
) -> StudioState:
    """Pick the ball around the surface at a place of the picture."""
    base = state.scene.base
    centre = surface_point(state.scene.splats, camera, _pixel_of(camera, place))
    if not within_distance(base.means, centre[None].to(base.means), radius).any():
        raise StyleSplatError("Nothing lies in this ball. Click an object, or enlarge the radius.")
    middle = to_world(_rounded(centre), base.world_offset).tolist()
    ball = (*middle, round(radius, DECIMALS))
    return _shaped(state, how, Selection(sphere=(("", ball),)))


def pick_surface(
    state: StudioState, camera: Cameras, place: PicturePoint, size: PickSize, how: How = "new"
) -> StudioState:
    """Pick what shows at a place of the picture, without labels, as large as `size` says."""
    scene, click = state.scene, (camera, _pixel_of(camera, place))
    try:
        mask = pick_clicked(scene.base, scene.cameras, [click], size=size)
    except NothingToPick as error:
        raise StyleSplatError(
            f"No {size} ends around this place: it is background, or nothing solid. Click another "
            "place, choose another size, or use the brush."
        ) from error
    return _shaped(state, how, Selection(rows=IN_MEMORY), mask)


def pick_alike(
    state: StudioState, camera: Cameras, place: PicturePoint, reach: float, how: How = "new"
) -> StudioState:
    """Pick the surface around a place as far as it looks the same, `reach` at most."""
    splats = state.scene.splats
    point = surface_point(splats, camera, _pixel_of(camera, place))[None].to(splats.means)
    seeds = within_distance(splats.means, point, reach / SEEDS)
    if not seeds.any():
        distances = (splats.means - point).norm(dim=1)
        seeds = distances == distances.min()
    mask = state.scene.most_of(grow_by_similarity(splats, seeds, reach))
    return _shaped(state, how, Selection(rows=IN_MEMORY), mask)


@torch.no_grad()
def pick_drawn(
    state: StudioState, camera: Cameras, inside: Bool[Tensor, "H W"], how: How = "new"
) -> StudioState:
    """Pick what shows mostly inside a region of a picture, and lies close beneath that."""
    scene, base = state.scene, state.scene.base
    masks = torch.stack([inside, ~inside], dim=-1)
    within, beside = scene.to_base(pixels_in(scene.splats, camera, [masks])).unbind(dim=1)
    rows = (within > beside) & (within > LEAST_SHOWN)
    if not rows.any():
        raise StyleSplatError("Nothing shows inside the line. Draw it around an object.")
    places, depths = project(base.means, camera)
    column, row = places.floor().long().unbind(1)
    height, width = inside.shape
    seen = (depths > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    below = inside[row.clamp(0, height - 1), column.clamp(0, width - 1)] & seen
    rows |= grow(base, rows, BENEATH) & below
    return _shaped(state, how, Selection(rows=IN_MEMORY), rows)


def _rounded(places: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3"]:
    return places.cpu().double().apply_(lambda value: round(value, DECIMALS))


def region_of(
    shape: Shape, points: Sequence[PicturePoint], size: tuple[int, int], radius: float
) -> Bool[Tensor, "H W"]:
    """The pixels in a line that is drawn; the brush's radius is a share of the height."""
    width, height = size
    image = Image.new("1", size)
    draw, line = ImageDraw.Draw(image), [(x * width, y * height) for x, y in points]
    if shape == "rectangle":
        (x0, y0), (x1, y1) = line[0], line[-1]
        draw.rectangle((min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)), 1)
    elif shape == "lasso" and len(line) > 2:
        draw.polygon(line, 1)
    elif shape == "brush":
        reach = max(radius * height, 0.5)
        draw.line(line, 1, max(1, round(2 * reach)))
        for x, y in line:
            draw.ellipse((x - reach, y - reach, x + reach, y + reach), 1)
    return torch.from_numpy(np.array(image))


def pick_box(
    state: StudioState, low: ViewVector, high: ViewVector, how: How = "new"
) -> StudioState:
    corners = _rounded(torch.tensor([low, high], dtype=torch.float64))
    places = to_world(corners, state.scene.world_offset)
    return _shaped(state, how, Selection(box3d=(tuple(places.flatten().tolist()),)))


def pick_words(state: StudioState, text: str) -> StudioState:
    # A download would take minutes, in which the page answers nothing
    if not is_at_hand(CHECKPOINT):
        raise StyleSplatError(
            "No model that knows words is installed. Run `pip install 'stylesplat[segment]'` and "
            f"`hf download {CHECKPOINT}`, then try again."
        )
    return _shaped(state, "new", Selection(text=(text,)))


def unite_picked(state: StudioState) -> StudioState:
    require_picked(state)
    return _selected(state, _free_name(state), Selection(plus=state.picked))


def subtract_picked(state: StudioState) -> StudioState:
    if len(state.picked) < 2:
        raise StyleSplatError(
            "Pick two objects or more: the others are subtracted from the first one."
        )
    first, *others = state.picked
    return _selected(state, _free_name(state), Selection(plus=(first,), minus=tuple(others)))


def resize_picked(state: StudioState, share: float) -> StudioState:
    """Let what is picked grow by a share of its extent, or shrink if that is negative."""
    require_picked(state)
    wider, smaller = (share, None) if share > 0 else (None, -share)
    selection = Selection(plus=state.picked, grow=wider, shrink=smaller)
    return _selected(state, _own_name(state), selection)


def rename_picked(state: StudioState, name: str) -> StudioState:
    if len(state.picked) != 1:
        raise StyleSplatError("Pick one object to give it a name.")
    (old,) = state.picked
    if old not in state.scene.objects:  # a label id
        return _selected(state, name, Selection(ids=(int(old),)))
    scene = rename(state.scene, old, name)
    hidden = frozenset(name if each == old else each for each in state.hidden)
    note = f"Renamed {old} to {name}"
    return replace(state, picked=(name,), hidden=hidden, scene=scene, note=note)


def forget_picked(state: StudioState) -> StudioState:
    """Delete the picked names; the Gaussians stay."""
    names = [name for name in state.picked if name in state.scene.objects]
    if not names:
        raise StyleSplatError("Only names can be deleted. Pick an object that has one.")
    scene = state.scene
    for name in names:
        scene = delete(scene, name)
    return replace_scene(state, scene, f"Deleted the name {', '.join(names)}")


def hide_objects(state: StudioState, names: Sequence[str], hide: bool) -> StudioState:
    hidden = state.hidden | {*names} if hide else state.hidden - {*names}
    picked = tuple(name for name in state.picked if name not in hidden)
    note = f"{'Hid' if hide else 'Showed'} {', '.join(names)}"
    return replace(state, hidden=hidden, picked=picked, note=note)


def _pixel_of(camera: Cameras, place: PicturePoint) -> tuple[float, float]:
    width, height = camera.size
    x, y = (min(each, 0.9999) for each in place)
    return x * width, y * height


def _shaped(
    state: StudioState, how: How, selection: Selection, mask: Bool[Tensor, " B"] | None = None
) -> StudioState:
    """Make a pick of a selection, or add the selection to the pick, or subtract it."""
    if how == "new" or not state.picked:
        if how == "away":
            raise StyleSplatError("Nothing is picked to take away from.")
        return _selected(state, _free_name(state), selection, mask)
    if how == "add":
        both = msgspec.structs.replace(selection, plus=state.picked)
        return _selected(state, _own_name(state), both, mask)
    found = resolve_selection(state.scene, selection, mask=mask).mask
    own = torch.stack([find_object(state.scene, name) for name in state.picked]).any(dim=0)
    return _selected(state, _own_name(state), Selection(rows=IN_MEMORY), own & ~found)


def _selected(
    state: StudioState, name: str, selection: Selection, mask: Bool[Tensor, " B"] | None = None
) -> StudioState:
    scene = state.scene.with_object(name, resolve_selection(state.scene, selection, mask=mask))
    return replace(state, scene=scene, picked=(name,), note=f"Selected {name}")


def _own_name(state: StudioState) -> str:
    """The name of the pick if it was made here, and not painted; else a new name."""
    made = [name for name in state.picked if re.fullmatch(MADE.format(r"\d+"), name)]
    if len(state.picked) == 1 and made and made[0] not in state.scene.painted_objects:
        return made[0]
    return _free_name(state)


def _free_name(state: StudioState) -> str:
    taken = {*state.scene.objects, *state.scene.painted_objects}
    names = (MADE.format(number) for number in range(1, len(taken) + 2))
    return next(name for name in names if name not in taken)
