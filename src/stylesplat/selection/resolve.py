"""Selections, names and label ids resolved: the Gaussians of a scene that they stand for."""

from collections.abc import Iterator, Sequence
from typing import Any, get_args

import torch
from jaxtyping import Bool
from msgspec.structs import replace
from torch import Tensor

from stylesplat.errors import StyleSplatError, shell_command
from stylesplat.io.gaussian_lists import read_rows
from stylesplat.options import PickSize
from stylesplat.progress import say
from stylesplat.rendering.render import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.objects import SceneObject, is_id
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import THRESHOLD, Selection
from stylesplat.scene.world_offset import from_world
from stylesplat.selection.labels import each_object, object_ids, pick, require_any, resolve_ids
from stylesplat.selection.shapes import grow, in_box, in_sphere, shrink, surface_point
from stylesplat.selection.text import clear_winner, load_detector, rank_objects


def resolve_selection(
    scene: Scene,
    selection: Selection,
    *,
    name: str | None = None,
    mask: Bool[Tensor, " B"] | None = None,
    device: str = "auto",
) -> SceneObject:
    """Find the Gaussians of a selection, and the label ids that it means.

    An object that is called `name` now counts as background. `mask` is what `rows` stands for, if
    no file lists it. Texts are found by a model on the device.
    """
    whole = None if selection.of is None else whole_of(scene, selection.of, name)
    clicks = whole is not None or selection.size is not None or scene.base.classifier is None
    by_label = selection.ids or selection.boxes or selection.text or selection.background
    if not (by_label or (not clicks and (selection.points or selection.not_points))):
        _refuse_rules(selection)
    excluded = [] if clicks else _ids_at(scene, selection.not_points, "point")
    masks = [find_object(scene, each) for each in selection.plus]
    masks += _shapes(scene, selection, name or "", mask)
    if selection.background:
        masks.append(background_of(scene, name, threshold=selection.threshold))
    if clicks and (selection.points or selection.not_points or selection.size):
        masks.append(_clicked(scene, selection))
    named, scores = _ids_at(scene, selection.boxes, "box"), dict[int, float]()
    named += [] if clicks else _ids_at(scene, selection.points, "point")
    if selection.ids:
        named = [*resolve_ids(scene.splats, object_id=selection.ids, folder=scene.path), *named]
    if selection.text:
        if not all(text.strip() for text in selection.text):
            raise StyleSplatError("The text is empty. Say what to find, such as 'red chair'.")
        object_ids(scene.base)  # refuses splats without objects before a model is downloaded
        detector = load_detector(selection.model, pick_device(device))
        names = {id: name for name, each in scene.objects.items() for id in each.selection.ids}
        for text in selection.text:
            ranking = rank_objects(scene.base, scene.cameras, text, detector)
            fits = {id: score for id, score in ranking.items() if id not in excluded}
            named.append(clear_winner(fits, text, names, folder=scene.path))
            scores |= {id: max(score, scores.get(id, score)) for id, score in fits.items()}
    ids = [id for id in dict.fromkeys(named) if id not in excluded]
    rules = {"threshold": selection.threshold, "remove_outliers": not selection.keep_outliers}
    if ids:
        masks.append(pick(scene.base, object_id=ids, **rules))
    if not masks:
        raise StyleSplatError(
            "Nothing is selected. Select with --id, --point, --box, --text, --box3d, --sphere, "
            "--rows, --plus, --all or --background; --not-point only excludes."
        )
    found = torch.stack(masks).any(dim=0)
    for other in selection.minus:
        found &= ~find_object(scene, other)
    rules["remove_outliers"] = False
    for _, picked in each_object(scene.base, excluded, **rules) if excluded else ():
        found &= ~picked
    if not found.any():
        raise StyleSplatError("Nothing is left of the selection. Exclude less.")
    if whole is not None:
        found = _part(scene, selection.of or "", whole, found)
    if selection.grow is not None:
        found = grow(scene.base, found, selection.grow)
        found = found if whole is None else found & whole
    if selection.shrink is not None:
        found = shrink(scene.base, found, selection.shrink)
    return SceneObject(found, replace(selection, ids=tuple(ids), scores=scores))


def _refuse_rules(selection: Selection) -> None:
    """Refuse what is said of Gaussians of a label where no label selects any."""
    if selection.threshold != THRESHOLD or selection.keep_outliers:
        option = "--keep-outliers" if selection.threshold == THRESHOLD else "--threshold"
        raise StyleSplatError(
            f"{option} means nothing here: it is for Gaussians that a label selects (--id, --box, "
            "--text, or --point in a scene with labels). Leave it out."
        )


def whole_of(scene: Scene, of: str, part: str | None) -> Bool[Tensor, " B"]:
    """The Gaussians of an object together with a part of it that has been taken from it before."""
    if of not in scene.objects:
        raise _unknown(scene, of)
    before = scene.objects.get(part or "")
    own = scene.objects[of].mask
    return own | before.mask if before and before.selection.of == of else own


def _part(
    scene: Scene, of: str, whole: Bool[Tensor, " B"], mask: Bool[Tensor, " B"]
) -> Bool[Tensor, " B"]:
    """What of a selection belongs to an object; refuses nothing of it, and all of it."""
    if not (mask & whole).any():
        others = [name for name, each in scene.objects.items() if (each.mask & mask).any()]
        where = f"it is part of {', '.join(others)}" if others else "no other object has it either"
        raise StyleSplatError(
            f"Nothing of the selection belongs to {of!r}; {where}. Name with --of the object that "
            f"it is a part of, or take it away from an object with --minus."
        )
    if not (whole & ~mask).any():
        raise StyleSplatError(
            f"The selection is all of {of!r}, not a part of it. Select less, or leave out --of."
        )
    return mask & whole


def find_object(scene: Scene, name: str) -> Bool[Tensor, " B"]:
    """The rows of the base that a name or a label id stands for; see `find_objects`."""
    return find_objects(scene, [name])[name]


def find_objects(scene: Scene, names: Sequence[str]) -> dict[str, Bool[Tensor, " B"]]:
    """The rows of the base that names and label ids stand for; finds all label ids in one pass.

    A name that only a layer has stands for the rows that it covers.

    Raises:
        StyleSplatError: If the scene lacks one of them.
    """
    layers = {layer.object: layer for layer in reversed(scene.layers)}
    found, ids = dict[str, Bool[Tensor, " B"]](), dict[str, int]()
    for name in names:
        if name in scene.objects:
            found[name] = scene.objects[name].mask
        elif name in layers:
            found[name] = layers[name].covered(len(scene.base))
        elif is_id(name) and scene.base.classifier is not None:
            (ids[name],) = resolve_ids(scene.base, object_id=int(name), folder=scene.path)
        else:
            raise _unknown(scene, name)
    masks = dict(each_object(scene.base, [*ids.values()])) if ids else {}
    for name, id in ids.items():
        require_any(masks[id], id)
        found[name] = masks[id]
    return found


def _unknown(scene: Scene, name: str) -> StyleSplatError:
    ids = map(str, object_ids(scene.base)) if scene.base.classifier else ()
    known = ", ".join([*scene.objects, *ids]) or "none"
    choice = ("--id", "N") if scene.base.classifier else ("--point", "VIEW:x,y")
    way = shell_command("select", scene.path or "SCENE", "--name", "NAME", *choice)
    return StyleSplatError(
        f"The scene has no object {name!r}. Names and ids: {known}. Name one with `{way}`."
    )


def names_of(scene: Scene, id: int) -> list[str]:
    """The names of the whole object of a label id."""
    return [name for name in scene.objects if whole_ids(scene, name) == (id,)]


def whole_ids(scene: Scene, name: str) -> tuple[int, ...]:
    """The label ids whose whole objects a name or an id stands for; none for other selections."""
    if name not in scene.objects:
        return (int(name),) if is_id(name) else ()
    has_parts = name in (each.selection.of for each in scene.objects.values())
    selection = scene.objects[name].selection
    return selection.ids if selection.is_whole and not has_parts else ()


def _clicked(scene: Scene, selection: Selection) -> Bool[Tensor, " B"]:
    """What is clicked on the surface, whether or not there are labels."""
    if not selection.points:
        raise StyleSplatError("--size and --not-point on a surface go with --point. Add one.")
    from stylesplat.selection.surface_cut import pick_clicked
    from stylesplat.selection.surface_graph import NothingToPick

    clicks = [
        [(_camera(scene, view), pixel) for view, pixel in places]
        for places in (selection.points, selection.not_points)
    ]
    size = selection.size or ("part" if selection.of else "object")
    found, faults = dict[PickSize, Bool[Tensor, " B"]](), dict[PickSize, NothingToPick]()
    for each in get_args(PickSize):
        try:
            found[each] = pick_clicked(scene.base, scene.cameras, *clicks, size=each)
        except NothingToPick as fault:
            faults[each] = fault
    counts = {each: int(picked.sum()) for each, picked in found.items()}
    others = ", ".join(f"--size {each} {n:,}" for each, n in counts.items() if each != size)
    if size not in found:
        offered = f" Here: {others} Gaussians." if others else ""
        raise NothingToPick(f"{faults[size]}{offered}")
    say(f"{size}: {counts[size]:,} Gaussians{others and '; '}{others}.")
    return found[size]


def _ids_at(scene: Scene, places: Sequence[tuple[str, Any]], what: str) -> list[int]:
    """The label ids of the boxes or points of views."""
    splats, folder = scene.splats, scene.path
    found = list[int]()
    for view, place in places:
        found += resolve_ids(splats, **{what: place}, camera=_camera(scene, view), folder=folder)
    return found


def _shapes(
    scene: Scene, selection: Selection, name: str, mask: Bool[Tensor, " B"] | None
) -> Iterator[Bool[Tensor, " B"]]:
    base = scene.base
    if selection.all:
        yield torch.ones_like(base.opacities, dtype=torch.bool)
    for file in selection.rows:
        listed = scene.most_of(read_rows(file, len(scene.splats), name)) if mask is None else mask
        yield listed.to(base.device)
    for corners in selection.box3d:
        ends = torch.tensor(corners, dtype=torch.float64).view(2, 3)
        low, high = from_world(ends, base.world_offset)
        yield in_box(base, low, high)
    for view, (*place, radius) in selection.sphere:
        if not view:
            centre = from_world(torch.tensor(place, dtype=torch.float64), base.world_offset)
        else:
            centre = surface_point(scene.splats, _camera(scene, view), (place[0], place[1]))
        yield in_sphere(base, centre, radius)


def _camera(scene: Scene, view: str) -> Cameras:
    return scene.cameras[scene.cameras.index(view)]


def background_of(
    scene: Scene, name: str | None = None, *, threshold: float = THRESHOLD
) -> Bool[Tensor, " B"]:
    """The rows of the base that belong to no object, at least one.

    Objects are those of the label ids; in a scene without label ids, those that have a name other
    than `name`.
    """
    if scene.base.classifier is not None:
        ids = object_ids(scene.base)
        found = each_object(scene.base, ids, threshold=threshold, remove_outliers=False)
        masks = (picked for _, picked in found)
    else:
        masks = (
            each.mask
            for other, each in scene.objects.items()
            if other != name and not (each.selection.all or each.selection.background)
        )
    left = ~torch.zeros_like(scene.base.opacities, dtype=torch.bool)
    for picked in masks:
        left &= ~picked
    if left.all():
        raise StyleSplatError(
            "The scene has no objects, so all of it is background. Select it with --all, or name "
            "objects first."
        )
    if not left.any():
        raise StyleSplatError("Every Gaussian belongs to an object. Nothing is background.")
    return left
