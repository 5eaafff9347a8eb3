"""Selections: objects by id, pixels, words and shapes, united, without what is excluded."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError, shell_command
from stylesplat.options import PickSize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.objects import SceneObject, is_id
from stylesplat.scene.scene import Scene
from stylesplat.scene.world_offset import from_world
from stylesplat.selection.labels import (
    THRESHOLD,
    Point,
    ViewBox,
    each_object,
    object_ids,
    pick,
    require_any,
    resolve_ids,
)
from stylesplat.selection.shapes import grow, in_box, in_sphere, shrink, surface_point
from stylesplat.selection.text import Detector, clear_winner, rank_objects

# Selections with these are not the whole object
SHAPING = frozenset(
    {"plus", "minus", "of", "box3d", "sphere", "rows", "all", "background"}
    | {"grow", "shrink", "size"}
)
ALONE = frozenset({"text", "box3d", "sphere"})  # no list in objects.json where there is one


@dataclass(frozen=True, eq=False)
class Choice:
    """The union of all that is named, without what is excluded; see the arguments of `select`."""

    ids: tuple[int, ...] = ()
    boxes: tuple[tuple[str, ViewBox], ...] = ()
    points: tuple[tuple[str, Point], ...] = ()
    not_points: tuple[tuple[str, Point], ...] = ()
    of: str | None = None
    size: PickSize | None = None
    text: tuple[str, ...] = ()
    box3d: tuple[tuple[float, ...], ...] = ()
    sphere: tuple[tuple[str, tuple[float, ...]], ...] = ()
    """A view or none, the centre, and the radius."""
    rows: tuple[tuple[str, Bool[Tensor, " B"]], ...] = ()
    """Listed Gaussians of the base, and the source of each list."""
    plus: tuple[str, ...] = ()
    minus: tuple[str, ...] = ()
    all: bool = False
    background: bool = False
    grow: float | None = None
    shrink: float | None = None

    def __post_init__(self) -> None:
        if self.grow is not None and self.shrink is not None:
            raise StyleSplatError("An object cannot grow and shrink. Pass --grow or --shrink.")
        if not all(text.strip() for text in self.text):
            raise StyleSplatError(
                "The text is empty. Say what to find, such as --text 'red chair'."
            )


def choose(
    scene: Scene,
    choice: Choice,
    *,
    name: str | None = None,
    threshold: float = THRESHOLD,
    remove_outliers: bool = True,
    detector: Detector | None = None,
) -> SceneObject:
    """Find the Gaussians of a choice; texts are found by the detector.

    An object that is called `name` now counts as background. For `threshold` and
    `remove_outliers` see `pick`.
    """
    whole = None if choice.of is None else whole_of(scene, choice.of, name)
    clicks = whole is not None or choice.size is not None or scene.base.classifier is None
    by_label = choice.ids or choice.boxes or choice.text or choice.background
    if not (by_label or (not clicks and (choice.points or choice.not_points))):
        _refuse_rules(threshold, remove_outliers=remove_outliers)
    excluded = [] if clicks else _ids_at(scene, choice.not_points)
    masks = [*_shapes(scene, choice), *(find_object(scene, each) for each in choice.plus)]
    if choice.background:
        masks.append(background_of(scene, name, threshold=threshold))
    if clicks and (choice.points or choice.not_points or choice.size):
        masks.append(_clicked(scene, choice))
    named, scores = _ids(scene, choice), dict[int, float]()
    named += [] if clicks else _ids_at(scene, choice.points)
    names = {id: name for name, each in scene.objects.items() for id in each.how.get("ids", [])}
    for text in choice.text:
        assert detector is not None  # whoever takes texts loads one
        ranking = rank_objects(scene.base, scene.cameras, text, detector)
        fits = {id: score for id, score in ranking.items() if id not in excluded}
        named.append(clear_winner(fits, text, names, folder=scene.path))
        scores |= {id: max(score, scores.get(id, score)) for id, score in fits.items()}
    ids = [id for id in dict.fromkeys(named) if id not in excluded]
    if ids:
        rules = {"threshold": threshold, "remove_outliers": remove_outliers}
        masks.append(pick(scene.base, object_id=ids, **rules))
    if not masks:
        raise StyleSplatError(
            "Nothing is selected. Select with --id, --point, --box, --text, --box3d, --sphere, "
            "--rows, --plus, --all or --background; --not-point only excludes."
        )
    mask = torch.stack(masks).any(dim=0)
    for other in choice.minus:
        mask &= ~find_object(scene, other)
    outliers_too = each_object(scene.base, excluded, threshold=threshold, remove_outliers=False)
    for _, picked in outliers_too if excluded else ():
        mask &= ~picked
    if not mask.any():
        raise StyleSplatError("Nothing is left of the selection. Exclude less.")
    if whole is not None:
        mask = _part(scene, choice.of or "", whole, mask)
    if choice.grow is not None:
        mask = grow(scene.base, mask, choice.grow)
        mask = mask if whole is None else mask & whole
    if choice.shrink is not None:
        mask = shrink(scene.base, mask, choice.shrink)
    how: dict[str, Any] = {"ids": ids, "threshold": threshold}
    given = {key: value for key, value in asdict(choice).items() if value and key != "ids"}
    how |= {key: _recorded(key, value) for key, value in given.items()}
    return SceneObject(mask, how | ({"scores": scores} if scores else {}))


def _refuse_rules(threshold: float, *, remove_outliers: bool) -> None:
    """Refuse what is said of Gaussians of a label where no label selects any."""
    given = {"--threshold": threshold != THRESHOLD, "--keep-outliers": not remove_outliers}
    for option in (name for name, is_given in given.items() if is_given):
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
    return own | before.mask if before and before.how.get("of") == of else own


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
            found[name] = layers[name].mask(len(scene.base))
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
    way = shell_command("select", scene.path or "SCENE", "--name", "NAME", "--id", "N")
    return StyleSplatError(
        f"The scene has no object {name!r}. Names and ids: {known}. Name one with `{way}`."
    )


def names_of(scene: Scene, id: int) -> list[str]:
    """The names of the whole object of a label id."""
    return [
        name
        for name, each in scene.objects.items()
        if each.how.get("ids") == [id] and _is_whole(scene, name)
    ]


def whole_ids(scene: Scene, name: str) -> tuple[int, ...]:
    """The label ids whose whole objects a name or an id stands for; none for other selections."""
    if name not in scene.objects:
        return (int(name),) if is_id(name) else ()
    return tuple(scene.objects[name].how.get("ids", ())) if _is_whole(scene, name) else ()


def _is_whole(scene: Scene, name: str) -> bool:
    """Whether a name stands for the whole objects of its label ids."""
    parts = (each.how.get("of") for each in scene.objects.values())
    return name not in parts and not SHAPING & scene.objects[name].how.keys()


def _ids(scene: Scene, choice: Choice) -> list[int]:
    """The label ids of `ids` and boxes."""
    splats, folder = scene.splats, scene.path
    found = [*resolve_ids(splats, object_id=choice.ids, folder=folder)] if choice.ids else []
    for view, box in choice.boxes:
        found += resolve_ids(splats, box=box, camera=_camera(scene, view), folder=folder)
    return found


def _clicked(scene: Scene, choice: Choice) -> Bool[Tensor, " B"]:
    """What is clicked on the surface, whether or not there are labels."""
    if not choice.points:
        raise StyleSplatError("--size and --not-point on a surface go with --point. Add one.")
    from stylesplat.selection.surface_cut import pick_clicked

    size = choice.size or ("part" if choice.of else "object")
    return pick_clicked(scene.base, scene.cameras, choice.points, choice.not_points, size)


def _ids_at(scene: Scene, points: Sequence[tuple[str, Point]]) -> list[int]:
    return [
        id
        for view, point in points
        for id in resolve_ids(
            scene.splats, point=point, camera=_camera(scene, view), folder=scene.path
        )
    ]


def _shapes(scene: Scene, choice: Choice) -> Iterator[Bool[Tensor, " B"]]:
    base = scene.base
    if choice.all:
        yield torch.ones_like(base.opacities, dtype=torch.bool)
    for _, mask in choice.rows:
        yield mask.to(base.device)
    for corners in choice.box3d:
        ends = torch.tensor(corners, dtype=torch.float64).view(2, 3)
        low, high = from_world(ends, base.world_offset)
        yield in_box(base, low, high)
    for view, (*place, radius) in choice.sphere:
        if not view:
            centre = from_world(torch.tensor(place, dtype=torch.float64), base.world_offset)
        else:
            centre = surface_point(scene.splats, _camera(scene, view), (place[0], place[1]))
        yield in_sphere(base, centre, radius)


def _recorded(key: str, value: Any) -> Any:
    """What `objects.json` records of a choice."""
    if key == "rows":
        return [where for where, _ in value]
    return value[0] if key in ALONE and len(value) == 1 else value


def _camera(scene: Scene, view: str) -> Cameras:
    return scene.cameras[scene.cameras.index(view)]


WHOLE = frozenset({"all", "background"})  # selections with these are no objects beside others


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
            if other != name and not WHOLE & each.how.keys()
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
