"""What the panel Pick does: objects picked by their names, by clicks, rectangles and shapes."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.models.hub import is_at_hand
from stylesplat.rendering.shares import AT_ONCE, render_shares
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import crop, depths_of
from stylesplat.scene.scene import Scene
from stylesplat.selection.identities import MIN_COVERAGE
from stylesplat.selection.shapes import surface_point
from stylesplat.selection.text import CHECKPOINT
from stylesplat.studio_app.studio_state import Masks, State, names_in, unless_all, with_scene
from stylesplat.verbs.delete import delete
from stylesplat.verbs.rename import rename
from stylesplat.verbs.select import select

How = Literal["new", "add", "away"]

AROUND = 1  # pixels about a click that are looked at, too
MADE = "pick {}"  # names of what is picked by shapes
TAKEN = "taken away"  # the name of what is taken away, while it has one


def pick_names(state: State, names: Sequence[str], how: How = "new") -> State:
    """Pick objects, or some more, or no longer."""
    if how == "away":
        picked = tuple(name for name in state.picked if name not in names)
    else:
        before = state.picked if how == "add" else ()
        picked = tuple(dict.fromkeys((*before, *names)))
    words = ", ".join(picked) or "nothing"
    return replace(state, picked=picked, glow=True, note=f"Picked {words}")


def object_in(
    state: State,
    masks: Masks,
    camera: Cameras,
    low: tuple[float, float],
    high: tuple[float, float],
) -> str | None:
    """The object that shows most in a rectangle of a camera's picture; None if none does.

    Of those that show alike, it is the smallest.

    Args:
        state: What is shown.
        masks: Knows which Gaussians each object is.
        camera: One camera.
        low: Left and top, in pixels.
        high: Right and bottom.
    """
    scene = state.scene
    names = [name for name in names_in(scene) if name not in state.hidden]
    if not names:
        return None
    size = [max(1, round(b - a)) for a, b in zip(low, high, strict=True)]
    shares = torch.stack([masks.of(scene, name) for name in names], dim=1)
    counts = shares.sum(dim=0)
    splats, hidden = scene.splats, unless_all(masks.together(scene, state.hidden))
    if hidden is not None:
        splats, shares = splats[~hidden], shares[~hidden]
    seen = render_shares(splats, crop(camera, low, size), shares.to(splats.means))
    seen = seen.mean(dim=(0, 1))
    if seen.max() < MIN_COVERAGE / AT_ONCE:
        return None
    alike = seen >= 0.95 * seen.max()
    return names[int(counts.masked_fill(~alike, len(splats) + 1).argmin())]


def object_at(
    state: State, masks: Masks, camera: Cameras, place: tuple[float, float]
) -> str | None:
    """The object that shows at a pixel; None if none does."""
    x, y = (float(int(each)) for each in place)
    low, high = (x - AROUND, y - AROUND), (x + 1 + AROUND, y + 1 + AROUND)
    return object_in(state, masks, camera, low, high)


def pixel_of(camera: Cameras, place: tuple[float, float]) -> tuple[float, float]:
    """A place in shares of a picture, 0 to 1, as a pixel of it, within its bounds."""
    width, height = camera.size
    x, y = (min(max(each, 0.0), 0.9999) for each in place)
    return x * width, y * height


def pick_at(
    state: State, masks: Masks, camera: Cameras, place: tuple[float, float], how: How = "new"
) -> State:
    """Pick the object that shows at a pixel; where none does, nothing."""
    found = object_at(state, masks, camera, place)
    if found is None:
        return pick_names(state, [], how) if how == "new" and state.picked else state
    return pick_names(state, [found], how)


def pick_ball(
    state: State, camera: Cameras, place: tuple[float, float], radius: float, how: How = "new"
) -> State:
    """Pick what lies around the surface at a pixel; or add that to the pick; or take it away.

    Args:
        state: What is picked now.
        camera: One camera.
        place: Of its pixels.
        radius: In world units.
        how: What becomes of it.

    Raises:
        StyleSplatError: If nothing solid shows there.
    """
    return _ball(state, surface_point(state.scene.splats, camera, place), radius, how)


def pick_round(
    state: State,
    camera: Cameras,
    low: tuple[float, float],
    high: tuple[float, float],
    how: How = "new",
) -> State:
    """Pick the ball that fits into a rectangle of a camera's picture, around the surface there.

    Args:
        state: What is picked now.
        camera: One camera.
        low: Left and top, in pixels.
        high: Right and bottom.
        how: What becomes of it.

    Raises:
        StyleSplatError: If nothing solid shows in its middle.
    """
    across, down = ((a + b) / 2 for a, b in zip(low, high, strict=True))
    centre = surface_point(state.scene.splats, camera, (across, down))
    pixels = min(b - a for a, b in zip(low, high, strict=True)) / 2
    depth = float(depths_of(centre[None], camera)[0])
    return _ball(state, centre, pixels * depth / float(camera.Ks[0, 0, 0]), how)


def _ball(state: State, centre: Float[Tensor, " 3"], radius: float, how: How) -> State:
    sphere = tuple(round(float(number), 5) for number in (*centre.tolist(), radius))
    return _shaped(state, {"sphere": sphere}, how)


def pick_box(state: State, low: Sequence[float], high: Sequence[float], how: How = "new") -> State:
    """Pick what lies in a box along the world's axes.

    Raises:
        StyleSplatError: If nothing does.
    """
    box = tuple(round(float(number), 5) for number in (*low, *high))
    return _shaped(state, {"box3d": box}, how)


def pick_words(state: State, text: str) -> State:
    """Pick the object that words mean.

    Raises:
        StyleSplatError: If no model is installed that knows words, or they mean none.
    """
    # A download would take minutes, in which the page answers nothing
    if not is_at_hand(CHECKPOINT):
        raise StyleSplatError(
            "No model that knows words is installed. Run `pip install 'stylesplat[segment]'` and "
            f"`hf download {CHECKPOINT}`, then try again."
        )
    return _shaped(state, {"text": text}, "new")


def united(state: State) -> State:
    """Make one object of all that are picked."""
    _require_picked(state)
    return _selected(state, _free_name(state.scene), {"plus": state.picked})


def difference(state: State) -> State:
    """Take all that are picked but the first away from that one.

    Raises:
        StyleSplatError: If fewer than two are picked, or nothing is left.
    """
    if len(state.picked) < 2:
        raise StyleSplatError("Pick two objects: from the first the others are taken away.")
    first, *others = state.picked
    return _selected(state, _free_name(state.scene), {"plus": (first,), "minus": tuple(others)})


def resized(state: State, share: float) -> State:
    """Let what is picked grow by a share of its extent, or shrink where that is negative."""
    _require_picked(state)
    change = {"grow": share} if share > 0 else {"shrink": -share}
    return _selected(state, _own_name(state), {"plus": state.picked, **change})


def renamed(state: State, name: str) -> State:
    """Call the one object that is picked something else.

    Raises:
        StyleSplatError: If not one is picked, or it cannot be called that.
    """
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


def forgotten(state: State) -> State:
    """Forget the names that are picked; their Gaussians stay."""
    names = [name for name in state.picked if name in state.scene.objects]
    if not names:
        raise StyleSplatError("Only objects that were named can be forgotten. Pick one of them.")
    scene = state.scene
    for name in names:
        scene = delete(scene, name)
    commands = (*state.commands, *(("delete", "SCENE", name) for name in names))
    return replace(with_scene(state, scene, f"Forgot {', '.join(names)}"), commands=commands)


def hidden(state: State, hide: bool) -> State:
    """Hide what is picked, or show everything again."""
    names = state.hidden | set(state.picked) if hide else frozenset()
    picked = () if hide else state.picked
    note = f"Hid {', '.join(sorted(names))}" if hide else "Showed everything"
    return replace(state, hidden=names, picked=picked, alone=False, note=note)


def alone(state: State, only: bool) -> State:
    """Show what is picked alone, or with all the rest."""
    return replace(state, alone=only, note="Showed alone" if only else "Showed with the rest")


def _shaped(state: State, shape: dict[str, Any], how: How) -> State:
    """What a shape holds as a pick, or added to it, or taken away from it."""
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


def _selected(state: State, name: str, choice: dict[str, Any]) -> State:
    """A new object, picked; and how the command line would make it."""
    scene = select(state.scene, name, **choice)
    words = ["select", "SCENE", "--name", name]
    for key, value in choice.items():
        several = key in ("plus", "minus") and not isinstance(value, str)
        for each in value if several else (value,):
            numbers = each if isinstance(each, tuple) else (each,)
            words.append(f"--{key}={','.join(map(str, numbers))}")  # the first may be negative
    commands = (*state.commands, tuple(words))
    state = replace(state, scene=scene, commands=commands, note=f"Made {name}")
    return replace(state, picked=(name,), glow=True)


def _own_name(state: State) -> str:
    """The name of the pick that may be changed: one that was made here, else a new one."""
    made = {words[3] for words in state.commands if words[0] == "select"}
    if len(state.picked) == 1 and state.picked[0] in made - {*state.scene.painted_objects}:
        return state.picked[0]
    return _free_name(state.scene)


def _free_name(scene: Scene) -> str:
    taken = {*scene.objects, *scene.painted_objects}
    return next(
        name for name in (MADE.format(n) for n in range(1, len(taken) + 2)) if name not in taken
    )


def _require_picked(state: State) -> None:
    if not state.picked:
        raise StyleSplatError("Nothing is picked. Click an object first.")
