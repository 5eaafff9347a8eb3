"""Picks objects by names, clicks, rectangles and shapes, and changes picked objects."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw
from torch import Tensor
from torch.nn.functional import pad

from stylesplat.errors import StyleSplatError
from stylesplat.models.hub import is_at_hand
from stylesplat.rendering.shares import AT_ONCE, contributed, render_shares
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import crop, project
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import find_object
from stylesplat.selection.identities import MIN_COVERAGE
from stylesplat.selection.shapes import alike, grow, near, surface_point
from stylesplat.selection.text import CHECKPOINT
from stylesplat.studio_app.history import (
    ObjectMasks,
    StudioState,
    none_if_all,
    object_names,
    replace_scene,
)
from stylesplat.studio_app.messages import How, Shape
from stylesplat.verbs.objects import delete, rename
from stylesplat.verbs.select import select

Pixel = tuple[float, float]

AROUND = 1  # pixels around a click that count, too
MADE = "object {}"  # names of picks that are made by shapes
BENEATH = 0.1  # of what shows: how deep what is beneath belongs to it
SEEDS = 25  # of the reach, within which what is around a click belongs to it whatever its look
LEAST_SHOWN = 0.05  # of a pixel, by which a Gaussian shows
DRAWN = "#"  # instead of a command, for what none makes
NEW, TAKEN = "new object", "taken away"  # the name of a shape while it is subtracted


def pick_names(state: StudioState, names: Sequence[str], how: How = "new") -> StudioState:
    if how == "away":
        picked = tuple(name for name in state.picked if name not in names)
    else:
        before = state.picked if how == "add" else ()
        picked = tuple(dict.fromkeys((*before, *names)))
    words = ", ".join(picked) or "nothing"
    return replace(state, picked=picked, note=f"Picked {words}")


def object_in(
    state: StudioState, masks: ObjectMasks, camera: Cameras, low: Pixel, high: Pixel
) -> str | None:
    """The object that shows most in a rectangle, or the smallest of those that show alike."""
    scene = state.scene
    names = [name for name in object_names(scene) if name not in state.hidden]
    if not names:
        return None
    size = [max(1, round(b - a)) for a, b in zip(low, high, strict=True)]
    shares = torch.stack([masks.of(scene, name) for name in names], dim=1)
    counts = shares.sum(dim=0)
    splats, hidden = scene.splats, none_if_all(masks.together(scene, state.hidden))
    if hidden is not None:
        splats, shares = splats[~hidden], shares[~hidden]
    seen = render_shares(splats, crop(camera, low, size), shares.to(splats.means))
    seen = seen.mean(dim=(0, 1))
    if seen.max() < MIN_COVERAGE / AT_ONCE:
        return None
    alike = seen >= 0.95 * seen.max()
    return names[int(counts.masked_fill(~alike, len(splats) + 1).argmin())]


def object_at(state: StudioState, masks: ObjectMasks, camera: Cameras, place: Pixel) -> str | None:
    x, y = (float(int(each)) for each in place)
    low, high = (x - AROUND, y - AROUND), (x + 1 + AROUND, y + 1 + AROUND)
    return object_in(state, masks, camera, low, high)


def pixel_of(camera: Cameras, place: Pixel) -> Pixel:
    """The pixel of a place in shares of a picture, 0 to 1."""
    width, height = camera.size
    x, y = (min(max(each, 0.0), 0.9999) for each in place)
    return x * width, y * height


def pick_at(
    state: StudioState, masks: ObjectMasks, camera: Cameras, place: Pixel, how: How = "new"
) -> StudioState:
    """Pick the object that shows at a pixel, or nothing where none shows."""
    found = object_at(state, masks, camera, place)
    if found is not None and how == "new" and state.picked == (found,):
        return state
    if found is None:
        return pick_names(state, [], how) if how == "new" and state.picked else state
    return pick_names(state, [found], how)


def pick_ball(
    state: StudioState, camera: Cameras, place: Pixel, radius: float, how: How = "new"
) -> StudioState:
    """Pick the ball around the surface at a pixel."""
    return _ball(state, surface_point(state.scene.splats, camera, place), radius, how)


def _ball(state: StudioState, centre: Float[Tensor, " 3"], radius: float, how: How) -> StudioState:
    sphere = tuple(round(float(number), 5) for number in (*centre.tolist(), radius))
    return _shaped(state, {"sphere": sphere}, how)


def pick_alike(
    state: StudioState, camera: Cameras, place: Pixel, reach: float, how: How = "new"
) -> StudioState:
    """Pick the surface around a pixel as far as it looks the same, `reach` at most."""
    splats = state.scene.splats
    point = surface_point(splats, camera, place)[None]
    seeds = near(splats.means, point.to(splats.means), reach / SEEDS)
    if not seeds.any():
        distances = (splats.means - point.to(splats.means)).norm(dim=1)
        seeds = distances == distances.min()
    return _masked(state, alike(splats, seeds, reach), how)


def spread_picked(state: StudioState, reach: float) -> StudioState:
    """Let what is picked spread over what looks the same, or with less than 0 what is around it."""
    _require_picked(state)
    own, splats = _own_mask(state), state.scene.splats
    if reach > 0:
        return _masked(state, alike(splats, own, reach), "add")
    border = near(splats.means, splats.means[own], -reach) & ~own
    return _masked(state, alike(splats, border, -reach), "away") if border.any() else state


@torch.no_grad()
def pick_drawn(
    state: StudioState, camera: Cameras, inside: Bool[Tensor, "H W"], how: How = "new"
) -> StudioState:
    """Pick what shows mostly inside a region of a picture, and lies close beneath that."""
    pixels = torch.stack([inside, ~inside], dim=-1).to(state.scene.splats.means)
    weights = contributed(state.scene.splats, camera, pad(pixels, (0, AT_ONCE - 2)))
    within, beside = weights[:, 0], weights[:, 1]
    rows = (within > beside) & (within > LEAST_SHOWN)
    if not rows.any():
        raise StyleSplatError("Nothing shows inside the line. Draw it around an object.")
    places, depths = project(state.scene.splats.means, camera)
    column, row = places.floor().long().unbind(1)
    height, width = inside.shape
    seen = (depths > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    below = inside[row.clamp(0, height - 1), column.clamp(0, width - 1)] & seen
    rows |= grow(state.scene.splats, rows, BENEATH) & below
    return _masked(state, rows, how)


def _own_mask(state: StudioState) -> Bool[Tensor, " N"]:
    own = [find_object(state.scene, name) for name in state.picked]
    return torch.stack(own).any(dim=0) if own else torch.zeros(len(state.scene.splats)).bool()


def _masked(state: StudioState, rows: Bool[Tensor, " N"], how: How) -> StudioState:
    """Pick Gaussians, or add them to the pick, or take them from it."""
    before = _own_mask(state)
    name = _free_name(state.scene) if how == "new" or not state.picked else _own_name(state)
    mask = {"new": rows, "add": before | rows, "away": before & ~rows}[how]
    if not mask.any():
        raise StyleSplatError("Nothing is left of the pick.")
    return _selected(state, name, {"rows": mask})


def region_of(
    shape: Shape, points: Sequence[Pixel], size: tuple[int, int], radius: float
) -> Bool[Tensor, "H W"]:
    """The pixels inside a line that is drawn on a picture.

    Args:
        shape: A rectangle between the first and the last point, a closed line, or a brush.
        points: In shares of the picture.
        size: Width and height of the picture in pixels.
        radius: Of the brush, as a share of the height.
    """
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
    state: StudioState, low: Sequence[float], high: Sequence[float], how: How = "new"
) -> StudioState:
    """Pick a box along the world's axes."""
    box = tuple(round(float(number), 5) for number in (*low, *high))
    return _shaped(state, {"box3d": box}, how)


def pick_words(state: StudioState, text: str) -> StudioState:
    """Pick the object that a phrase names."""
    # A download would take minutes, in which the page answers nothing
    if not is_at_hand(CHECKPOINT):
        raise StyleSplatError(
            "No model that knows words is installed. Run `pip install 'stylesplat[segment]'` and "
            f"`hf download {CHECKPOINT}`, then try again."
        )
    return _shaped(state, {"text": text}, "new")


def unite_picked(state: StudioState) -> StudioState:
    _require_picked(state)
    return _selected(state, _free_name(state.scene), {"plus": state.picked})


def subtract_picked(state: StudioState) -> StudioState:
    """Subtract all picked objects from the first one."""
    if len(state.picked) < 2:
        raise StyleSplatError(
            "Pick two objects or more: the others are subtracted from the first one."
        )
    first, *others = state.picked
    return _selected(state, _free_name(state.scene), {"plus": (first,), "minus": tuple(others)})


def resize_picked(state: StudioState, share: float) -> StudioState:
    """Let what is picked grow by a share of its extent, or shrink if that is negative."""
    _require_picked(state)
    change = {"grow": share} if share > 0 else {"shrink": -share}
    return _selected(state, _own_name(state), {"plus": state.picked, **change})


def rename_picked(state: StudioState, name: str) -> StudioState:
    if len(state.picked) != 1:
        raise StyleSplatError("Pick one object to give it a name.")
    (old,) = state.picked
    if old not in state.scene.objects:  # a label id
        return _selected(state, name, {"id": int(old)})
    scene = rename(state.scene, old, name)
    hidden = frozenset(name if each == old else each for each in state.hidden)
    state = replace(state, picked=(name,), hidden=hidden, scene=scene)
    command = ("rename", "SCENE", old, name)
    return replace(state, commands=(*state.commands, command), note=f"Renamed {old} to {name}")


def forget_picked(state: StudioState) -> StudioState:
    """Delete the picked names; the Gaussians stay."""
    names = [name for name in state.picked if name in state.scene.objects]
    if not names:
        raise StyleSplatError("Only names can be deleted. Pick an object that has one.")
    scene = state.scene
    for name in names:
        scene = delete(scene, name)
    commands = (*state.commands, *(("delete", "SCENE", name) for name in names))
    return replace(
        replace_scene(state, scene, f"Deleted the name {', '.join(names)}"), commands=commands
    )


def hide_objects(state: StudioState, names: Sequence[str], hide: bool) -> StudioState:
    hidden = state.hidden | {*names} if hide else state.hidden - {*names}
    picked = tuple(name for name in state.picked if name not in hidden)
    note = f"{'Hid' if hide else 'Showed'} {', '.join(names)}"
    return replace(state, hidden=hidden, picked=picked, alone=False, note=note)


def isolate_picked(state: StudioState, only: bool) -> StudioState:
    return replace(state, alone=only, note="Showed the pick alone" if only else "Showed everything")


def _shaped(state: StudioState, shape: dict[str, Any], how: How) -> StudioState:
    """Make a pick of a shape, or add the shape to the pick, or subtract it."""
    scene = state.scene
    if how == "new" or not state.picked:
        if how == "away":
            raise StyleSplatError("Nothing is picked to take away from.")
        return _selected(state, _free_name(scene), shape)
    name = _own_name(state)
    if how == "add":
        return _selected(state, name, {"plus": state.picked, **shape})
    taken = _selected(state, TAKEN, shape)
    less = _selected(taken, name, {"plus": state.picked, "minus": TAKEN})
    scene = delete(less.scene, TAKEN)
    commands = (*less.commands, ("delete", "SCENE", TAKEN))
    return replace(less, scene=scene, commands=commands)


def _selected(state: StudioState, name: str, choice: dict[str, Any]) -> StudioState:
    """Make a picked object, and note the command that makes it."""
    # Under a name of its own: `select` would tell of every stroke what the name meant before
    found = select(state.scene, NEW, **choice).objects[NEW]
    scene = state.scene.with_object(name, found)
    words = ["select", "SCENE", "--name", name]
    if "rows" in choice:
        words, choice = [DRAWN, f"{name!r} was drawn in the studio; saving the scene keeps it."], {}
    for key, value in choice.items():
        several = key in ("plus", "minus") and not isinstance(value, str)
        for each in value if several else (value,):
            numbers = each if isinstance(each, tuple) else (each,)
            words.append(f"--{key}={','.join(map(str, numbers))}")  # the first may be negative
    commands = (*state.commands, tuple(words))
    state = replace(state, scene=scene, commands=commands, note=f"Selected {name}")
    return replace(state, picked=(name,))


def _own_name(state: StudioState) -> str:
    """The name of the pick if it was made here, and not painted; else a new name."""
    made = [name for name in state.picked if re.fullmatch(MADE.format(r"\d+"), name)]
    if len(state.picked) == 1 and made and made[0] not in state.scene.painted_objects:
        return made[0]
    return _free_name(state.scene)


def _free_name(scene: Scene) -> str:
    taken = {*scene.objects, *scene.painted_objects}
    return next(
        name for name in (MADE.format(n) for n in range(1, len(taken) + 2)) if name not in taken
    )


def _require_picked(state: StudioState) -> None:
    if not state.picked:
        raise StyleSplatError("Nothing is picked. Click an object first.")
