"""What is picked: objects by name, and a selection, which lasts until something else is picked.

A selection is how much each Gaussian of the base belongs to it, in 255ths. It becomes an object by
a name, or by being painted.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.hub import is_at_hand
from stylesplat.options import PickSize
from stylesplat.rendering.render import colors_of, render
from stylesplat.rendering.weights import expected_depth, pixels_in
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import opaque_rows
from stylesplat.scene.layers import split_name
from stylesplat.scene.objects import SceneObject, free_name
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import IN_MEMORY, Selection
from stylesplat.scene.world_offset import to_world
from stylesplat.selection.resolve import find_object, resolve_selection
from stylesplat.selection.shapes import (
    feather,
    grow,
    grow_by_similarity,
    robust_diameter,
    shrink,
    surface_point,
    within_distance,
)
from stylesplat.selection.surface_cut import pick_clicked
from stylesplat.selection.surface_graph import NothingToPick
from stylesplat.selection.text import CHECKPOINT, NoMatch
from stylesplat.studio_app.history import (
    Selected,
    StudioState,
    replace_scene,
    require_objects,
    require_picked,
)
from stylesplat.studio_app.messages import Extreme, How, PicturePoint, Shape, Share, ViewVector
from stylesplat.training.initialize import neighbor_distances
from stylesplat.verbs.objects import delete, rename

BENEATH = 0.1  # of what shows: how deep what is beneath belongs to it
SEEDS = 25  # of the reach, within which what is around a click belongs to it whatever its look
LEAST_SHOWN = 0.05  # of a pixel, by which a Gaussian shows
DECIMALS = 5  # of places in the world that `objects.json` records
BY = {  # what a selection does to the one before
    "new": "Selected",
    "add": "Added to the selection",
    "away": "Removed from the selection",
    "within": "Cut the selection",
}


def pick_color(
    state: StudioState, camera: Cameras, place: PicturePoint, tolerance: float, how: How = "new"
) -> StudioState:
    """Select what has the colour of a place, both as seen from here: all colours are 0 to 1."""
    splats = state.scene.splats
    column, row = map(int, _pixel_of(camera, place))
    image, _ = render(splats, camera.crop((column, row), (1, 1)))
    rows = torch.arange(len(splats), device=splats.device)
    colors = colors_of(splats, rows, camera.positions.to(splats.means)).clamp(0, 1)
    alike = (colors - image[0, 0].clamp(0, 1)).norm(dim=1) <= tolerance
    return _combined(state, how, state.scene.most_of(alike).cpu())


def pick_extreme(state: StudioState, by: Extreme, share: Share) -> StudioState:
    """Select a share of all Gaussians: the largest, the faintest, or those farthest from others."""
    if not share:
        return pick_names(state, [])
    base = state.scene.base
    if by == "size":
        values = base.scales.amax(dim=1)
    elif by == "opacity":
        values = -base.opacities
    else:
        values = neighbor_distances(base.means.detach().cpu())
    count = max(1, round(share * len(values)))
    found = torch.zeros(len(values), dtype=torch.bool)
    return _combined(state, "new", found.index_fill(0, values.cpu().topk(count).indices, True))


def pick_names(state: StudioState, names: Sequence[str], how: How = "new") -> StudioState:
    """Pick objects; with a selection, add them to it, remove them, or keep what they share."""
    require_objects(state.scene, names)
    if how == "within" or (how != "new" and state.selection is not None):
        masks = [find_object(state.scene, name) for name in names]
        found = torch.stack(masks).any(dim=0) if masks else _nothing(state)
        return _combined(state, how, found, Selection(plus=tuple(names)))
    if how == "away":
        picked = tuple(name for name in state.picked if name not in names)
    else:
        before = state.picked if how == "add" else ()
        picked = tuple(dict.fromkeys((*before, *names)))
    if picked == state.picked and state.selection is None:
        return state
    note = f"Picked {', '.join(picked) or 'nothing'}"
    return replace(state, picked=picked, selection=None, note=note)


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
    return _resolved(state, how, Selection(sphere=(("", ball),)))


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
    return _combined(state, how, mask)


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
    return _combined(state, how, mask)


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
    pixels, is_seen, _ = _pixels_over(base.means, camera)
    rows |= grow(base, rows, BENEATH) & inside[pixels] & is_seen
    return _combined(state, how, rows)


def _pixels_over(
    means: Float[Tensor, "B 3"], camera: Cameras
) -> tuple[tuple[Tensor, Tensor], Bool[Tensor, " B"], Float[Tensor, " B"]]:
    """The row and column of the pixel over each mean, whether it has one, and the mean's depth."""
    (width, height), (places, depths) = camera.size, project(means, camera)
    column, row = places.floor().long().unbind(1)
    seen = (depths > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return (row.clamp(0, height - 1), column.clamp(0, width - 1)), seen, depths


def _rounded(places: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3"]:
    return places.cpu().double().apply_(lambda value: round(value, DECIMALS))


@torch.no_grad()
def brushed(
    scene: Scene,
    camera: Cameras,
    region: Float[Tensor, "H W"],
    rows: Bool[Tensor, " B"],
    reach: float | None = None,
) -> Float[Tensor, " B"]:
    """How much of some Gaussians lies in a region of a picture: of what shows, and just beneath.

    What shows counts by its pixels, and what is beneath by its place: as far as `reach`, or as for
    `pick_drawn`.
    """
    base = scene.base
    parts = torch.stack([region, torch.ones_like(region)], dim=-1)
    within, shown = scene.to_base(pixels_in(scene.splats, camera, [parts])).unbind(dim=1)
    share = torch.where(shown > LEAST_SHOWN, within / shown.clamp(min=LEAST_SHOWN), 0.0)
    depths, alphas = expected_depth(scene.splats, camera)
    pixels, is_seen, own = _pixels_over(base.means, camera)
    if reach is None:
        reach = BENEATH * robust_diameter(base.means[opaque_rows(base, rows)])
    near = (alphas[pixels] > LEAST_SHOWN) & (own <= depths[pixels] + reach)
    beneath = torch.where(is_seen & rows & near, region[pixels].to(own), 0.0)
    return torch.where(rows, share.maximum(beneath), 0.0).cpu()


@torch.no_grad()
def reach_of(scene: Scene, camera: Cameras, region: Float[Tensor, "H W"], radius: float) -> float:
    """The radius of a brush in world units, where the scene is that lies below it."""
    depths, alphas = expected_depth(scene.splats, camera)
    below = depths[(region > 0).to(depths.device) & (alphas > 0.5)]
    if not len(below):
        raise StyleSplatError("Nothing solid lies below the brush. Brush over the scene.")
    return float(below.median()) * radius * camera.size[1] / float(camera.Ks[0, 1, 1])


def soft_brush(
    points: Sequence[PicturePoint], size: tuple[int, int], radius: float, soft: float
) -> Float[Tensor, "H W"]:
    """A brush along a line: 1 in its middle, fading over a share of its radius to its edge.

    The radius is a share of the picture's height.
    """
    image, reach = Image.new("1", size), max(radius * size[1], 0.5)
    ImageDraw.Draw(image).line([(x * size[0], y * size[1]) for x, y in (*points, points[-1])], 1)
    away = torch.from_numpy(distance_transform_edt(~np.array(image))).float()
    return ((reach - away) / max(soft * reach, 1e-3)).clamp(0, 1)


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
    return _resolved(state, how, Selection(box3d=(tuple(places.flatten().tolist()),)))


def pick_words(state: StudioState, text: str) -> StudioState:
    # A download would take minutes, in which the page answers nothing
    if not is_at_hand(CHECKPOINT):
        raise StyleSplatError(
            "Finding by words needs a model that is not installed here. The documentation's page "
            "on the studio says how to get it. Until then, pick by a click or with the brush."
        )
    try:
        return _resolved(state, "new", Selection(text=(text,)))
    except NoMatch as error:
        raise StyleSplatError(
            f"No object, or more than one, fits {text!r}. Use other words, or click the object."
        ) from error


def unite_picked(state: StudioState) -> StudioState:
    """Select what belongs to any of the picked objects."""
    require_picked(state)
    return _combined(state, "new", picked_weights(state), Selection(plus=state.picked))


def subtract_picked(state: StudioState) -> StudioState:
    """Select what belongs to the object that was picked first, and to none of the others."""
    if len(state.picked) < 2:
        raise StyleSplatError(
            "Pick two objects or more: the others are subtracted from the first one."
        )
    first, *others = state.picked
    return _resolved(state, "new", Selection(plus=(first,), minus=tuple(others)))


def resize_picked(state: StudioState, share: float) -> StudioState:
    """Let what is picked grow by a share of its extent, or shrink if that is negative."""
    require_picked(state)
    base, own = state.scene.base, picked_weights(state) >= 128
    found = grow(base, own, share) if share > 0 else shrink(base, own, -share)
    return _selected(state, found, f"{'Grew' if share > 0 else 'Shrank'} the selection")


def feather_picked(state: StudioState, share: float) -> StudioState:
    """Let the border of what is picked fade over a share of its extent."""
    require_picked(state)
    weights = feather(state.scene.base, picked_weights(state) >= 128, share)
    return _selected(state, (255 * weights).round().byte(), "Feathered the selection")


def invert_picked(state: StudioState) -> StudioState:
    require_picked(state)
    return _selected(state, 255 - picked_weights(state), "Inverted the selection")


def name_selection(state: StudioState, name: str) -> StudioState:
    """Make an object of the selection, in place of an earlier one of that name."""
    if state.selection is None:
        raise StyleSplatError("Nothing is selected. Select something first.")
    found = SceneObject(state.selection.weights >= 128, state.selection.record)
    scene = state.scene.with_object(name, found)
    note = f"Named the selection {name}"
    return replace(state, scene=scene, picked=(name,), selection=None, note=note)


def with_object_of_selection(state: StudioState, kind: str) -> StudioState:
    """The state whose selection is an object called like `painted part`, with all that fades."""
    assert state.selection is not None
    name = free_part_name(state, kind)
    found = SceneObject(state.selection.weights > 0, state.selection.record)
    scene = state.scene.with_object(name, found)
    return replace(state, scene=scene, picked=(name,), selection=None)


def free_part_name(state: StudioState, kind: str) -> str:
    taken = {*state.scene.objects, *state.scene.painted_objects}
    return free_name(f"{kind} part", taken.__contains__)


def rename_picked(state: StudioState, name: str) -> StudioState:
    if len(state.picked) != 1:
        raise StyleSplatError("Pick one object to give it a name.")
    (old,) = state.picked
    if old not in state.scene.objects:  # a label id
        found = resolve_selection(state.scene, Selection(ids=(int(old),)))
        scene = state.scene.with_object(name, found)
        return replace(state, picked=(name,), scene=scene, note=f"Named {old} {name}")
    scene = rename(state.scene, old, name)

    def renamed(each: str) -> str:  # a layer, or an object
        object, label = split_name(each)
        return each if object != old else f"{name}/{label}" if label else name

    hidden, locked = (frozenset(map(renamed, names)) for names in (state.hidden, state.locked))
    solo = state.solo
    if solo:
        solo = renamed(solo[0]), {renamed(each): shown for each, shown in solo[1].items()}
    note = f"Renamed {old} to {name}"
    return replace(
        state, picked=(name,), hidden=hidden, locked=locked, solo=solo, scene=scene, note=note
    )


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
    require_objects(state.scene, names)
    hidden = state.hidden | {*names} if hide else state.hidden - {*names}
    picked = tuple(name for name in state.picked if name not in hidden)
    note = f"{'Hid' if hide else 'Showed'} {', '.join(names)}"
    return replace(state, hidden=hidden, picked=picked, note=note)


def _pixel_of(camera: Cameras, place: PicturePoint) -> tuple[float, float]:
    width, height = camera.size
    x, y = (min(each, 0.9999) for each in place)
    return x * width, y * height


def picked_weights(state: StudioState) -> UInt8[Tensor, " B"]:
    """How much each Gaussian belongs to the selection, or else to what is picked."""
    if state.selection is not None:
        return state.selection.weights
    masks = [find_object(state.scene, name).cpu() for name in state.picked]
    return 255 * (torch.stack(masks).any(dim=0) if masks else _nothing(state)).byte()


def _nothing(state: StudioState) -> Bool[Tensor, " B"]:
    return torch.zeros(len(state.scene.base), dtype=torch.bool)


def _resolved(state: StudioState, how: How, selection: Selection) -> StudioState:
    return _combined(state, how, resolve_selection(state.scene, selection).mask, selection)


def _combined(
    state: StudioState,
    how: How,
    found: Bool[Tensor, " B"] | UInt8[Tensor, " B"],
    record: Selection | None = None,
) -> StudioState:
    """Select something, or change the selection by it: what is picked is one, too."""
    own = _in_255ths(found)
    if how == "new":
        return _selected(replace(state, picked=(), selection=None), own, BY[how], record)
    before = picked_weights(state)
    if not before.any() and how != "add":
        raise StyleSplatError("Nothing is selected that could be changed. Select something first.")
    own = {"add": before.maximum(own), "away": before.minimum(255 - own)}.get(
        how, before.minimum(own)
    )
    return _selected(state, own, BY[how])


def _in_255ths(rows: Bool[Tensor, " B"] | UInt8[Tensor, " B"]) -> UInt8[Tensor, " B"]:
    return rows.cpu() if rows.dtype == torch.uint8 else 255 * rows.cpu().byte()


def _selected(
    state: StudioState,
    weights: Bool[Tensor, " B"] | UInt8[Tensor, " B"],
    note: str,
    record: Selection | None = None,
) -> StudioState:
    weights = _in_255ths(weights)
    if not (weights >= 128).any():
        raise StyleSplatError("Nothing is left of the selection. Remove less.")
    known = state.selection
    origin = known.origin if known else state.picked[0] if len(state.picked) == 1 else ""
    found = Selected(weights, record or Selection(rows=IN_MEMORY), origin)
    return replace(state, selection=found, picked=(), note=note)
