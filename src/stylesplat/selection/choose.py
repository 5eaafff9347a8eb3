"""Selections: objects by id, pixels, words and shapes, united, without what is excluded."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.arguments import pasted
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.compose import family, mask_of
from stylesplat.scene.scene import Scene, SceneObject, is_id
from stylesplat.selection.identities import object_ids
from stylesplat.selection.pick import (
    THRESHOLD,
    Box,
    Point,
    each_object,
    pick,
    pick_objects,
    resolve_ids,
)
from stylesplat.selection.shapes import grow, in_box, in_sphere, shrink, surface_point
from stylesplat.selection.text import Detector, clear_winner, rank_objects

# Selections with these are not the whole object
SHAPING = frozenset(
    {"plus", "minus", "box3d", "sphere", "rows", "all", "background", "grow", "shrink"}
)
ALONE = frozenset({"text", "box3d", "sphere"})  # no list in objects.json where there is one


@dataclass(frozen=True)
class Choice:
    """The union of all that is named, without what is excluded."""

    ids: tuple[int, ...] = ()
    """Label ids."""
    boxes: tuple[tuple[str, Box], ...] = ()
    """A view and a rectangle of its pixels: the object that shows most inside."""
    points: tuple[tuple[str, Point], ...] = ()
    """A view and a pixel: the object that shows there."""
    not_points: tuple[tuple[str, Point], ...] = ()
    """Objects to exclude."""
    text: tuple[str, ...] = ()
    """A few words each: the object that fits them best."""
    box3d: tuple[tuple[float, ...], ...] = ()
    """Two corners in the world, the lower one first."""
    sphere: tuple[tuple[str, tuple[float, ...]], ...] = ()
    """A centre in the world and a radius; or a view, the pixel that shows the centre, a radius."""
    rows: tuple[tuple[str, Bool[Tensor, " N"]], ...] = ()
    """Listed Gaussians, and the source of each list."""
    plus: tuple[str, ...] = ()
    """Names of objects to add."""
    minus: tuple[str, ...] = ()
    """Names of objects to exclude."""
    all: bool = False
    """Everything."""
    background: bool = False
    """What belongs to no object."""
    grow: float | None = None
    """Share of its extent by which to grow the selection."""
    shrink: float | None = None
    """Share of its extent by which to shrink it."""

    def __post_init__(self) -> None:
        if self.grow is not None and self.shrink is not None:
            raise StyleSplatError("An object cannot grow and shrink. Pass --grow or --shrink.")
        if not all(text.strip() for text in self.text):
            raise StyleSplatError(
                "The text is empty. Say what to find, such as --text 'red chair'."
            )


class Rules(NamedTuple):
    """How `pick` decides which Gaussians are an object's."""

    threshold: float = THRESHOLD
    """Probability of the object above which a Gaussian belongs to it."""
    remove_outliers: bool = True
    """Whether to drop Gaussians that lie apart from the rest of an object."""


RULES = Rules()


def choose(
    scene: Scene,
    choice: Choice,
    *,
    name: str | None = None,
    rules: Rules = RULES,
    detector: Detector | None = None,
) -> SceneObject:
    """Find the Gaussians of a choice.

    Args:
        scene: The scene.
        choice: What to select.
        name: The name of the new object; an object of that name now counts as background.
        rules: How to decide which Gaussians are an object's.
        detector: Finds `choice.text`.

    Raises:
        StyleSplatError: If the scene has no such object, the text fits none or several, or
            nothing is left.
    """
    without = _ids_at(scene, choice.not_points)
    masks = [*_shapes(scene, choice), *(find_object(scene, each) for each in choice.plus)]
    if choice.background:
        masks.append(background_of(scene, name, threshold=rules.threshold))
    named, scores = _ids(scene, choice), dict[int, float]()
    for text in choice.text:
        assert detector is not None  # whoever takes texts loads one
        fits = _scores(scene, text, detector, without)
        named += (_winner(scene, fits, text),)
        scores |= {id: max(score, scores.get(id, score)) for id, score in fits.items()}
    ids = tuple(id for id in dict.fromkeys(named) if id not in without)
    if ids:
        picked = pick(scene.unpainted, object_id=ids, **rules._asdict())
        masks.append(_extended(scene, picked))
    if not masks:
        raise StyleSplatError(
            "Nothing is selected. Select with --id, --point, --box, --text, --box3d, --sphere, "
            "--rows, --plus, --all or --background; --not-point only excludes."
        )
    mask = torch.stack(masks).any(dim=0)
    for each in _taken_away(scene, choice, without, rules.threshold):
        mask &= ~each
    if not mask.any():
        raise StyleSplatError("Nothing is left of the selection. Exclude less.")
    mask = _resized(scene, mask, choice)
    how: dict[str, Any] = {"ids": list(ids), "threshold": rules.threshold}
    how |= {"gaussians": int(mask.sum())}
    given = {key: value for key, value in asdict(choice).items() if value and key != "ids"}
    how |= {key: _recorded(key, value) for key, value in given.items()}
    return SceneObject(mask, how | ({"scores": scores} if scores else {}))


def find_object(scene: Scene, name: str) -> Bool[Tensor, " N"]:
    """The Gaussians of a name or a label id.

    Gaussians of layers belong to the objects of their parents; a name that only a layer has stands
    for the Gaussians that it covers.

    Raises:
        StyleSplatError: If the scene knows neither.
    """
    if name in scene.objects:
        return scene.objects[name].picked
    for layer in scene.layers:
        if layer.object == name:
            return mask_of(layer, scene)
    if is_id(name) and scene.splats.classifier is not None:
        ids = resolve_ids(scene.splats, object_id=int(name), folder=scene.path)
        return _extended(scene, pick(scene.unpainted, object_id=ids))
    ids = map(str, object_ids(scene.splats)) if scene.splats.classifier else ()
    known = ", ".join([*scene.objects, *ids]) or "none"
    way = pasted("select", scene.path or "SCENE", "--name", "NAME", "--id", "N")
    raise StyleSplatError(
        f"The scene has no object {name!r}. Names and ids: {known}. Name one with `{way}`."
    )


def find_objects(scene: Scene, names: Sequence[str]) -> dict[str, Bool[Tensor, " N"]]:
    """`find_object` for several names; label ids are looked up in one pass.

    Raises:
        StyleSplatError: If the scene lacks one of them.
    """
    told = {*scene.objects, *scene.painted_objects}
    classifier = scene.splats.classifier
    ids = {name: int(name) for name in names if is_id(name) and name not in told}
    if classifier is None or len(ids) < 2 or not {*ids.values()} <= {*object_ids(scene.splats)}:
        return {name: find_object(scene, name) for name in names}
    picked = pick_objects(scene.unpainted, [*ids.values()])
    picked = {id: _extended(scene, mask) for id, mask in picked.items()}
    there = {name: picked[id] for name, id in ids.items() if picked[id].any()}
    return {name: there[name] if name in there else find_object(scene, name) for name in names}


def _extended(scene: Scene, picked: Bool[Tensor, " N"]) -> Bool[Tensor, " M"]:
    """A pick of the base, with the Gaussians of layers that belong to it."""
    return picked[family(scene).to(picked.device)] if scene.layers else picked


def names_of(scene: Scene, id: int) -> list[str]:
    """The names of the whole object of a label id."""
    return [
        name
        for name, each in scene.objects.items()
        if each.how.get("ids") == [id] and not SHAPING & each.how.keys()
    ]


def whole_ids(scene: Scene, name: str) -> tuple[int, ...]:
    """The label ids whose whole objects a name or an id stands for; none if it is another pick."""
    if name not in scene.objects:
        return (int(name),) if is_id(name) else ()
    how = scene.objects[name].how
    return () if SHAPING & how.keys() else tuple(how.get("ids", ()))


def _taken_away(
    scene: Scene, choice: Choice, without: Sequence[int], threshold: float
) -> Iterator[Bool[Tensor, " N"]]:
    """Gaussians to exclude, with their strays."""
    for name in choice.minus:
        yield find_object(scene, name)
    if without:
        rules = Rules(threshold, remove_outliers=False)
        for _, picked in each_object(scene.unpainted, without, **rules._asdict()):
            yield _extended(scene, picked)


def _winner(scene: Scene, scores: dict[int, float], text: str) -> int:
    called = {id: name for name, each in scene.objects.items() for id in each.how.get("ids", [])}
    return clear_winner(scores, text, called, folder=scene.path)


def _ids(scene: Scene, choice: Choice) -> tuple[int, ...]:
    """The label ids of `ids`, boxes and points."""
    splats, folder = scene.splats, scene.path
    found = [*resolve_ids(splats, object_id=choice.ids, folder=folder)] if choice.ids else []
    for view, box in choice.boxes:
        found += resolve_ids(splats, box=box, camera=_camera(scene, view), folder=folder)
    return (*found, *_ids_at(scene, choice.points))


def _ids_at(scene: Scene, points: Sequence[tuple[str, Point]]) -> list[int]:
    return [
        id
        for view, point in points
        for id in resolve_ids(
            scene.splats, point=point, camera=_camera(scene, view), folder=scene.path
        )
    ]


def _scores(
    scene: Scene, text: str, detector: Detector, without: Sequence[int]
) -> dict[int, float]:
    """How well a text fits each object that is not excluded, as it looks without a style."""
    ranking = rank_objects(scene.unpainted, scene.cameras, text, detector)
    return {id: score for id, score in ranking.items() if id not in without}


def _shapes(scene: Scene, choice: Choice) -> Iterator[Bool[Tensor, " N"]]:
    splats = scene.splats
    if choice.all:
        yield torch.ones_like(splats.opacities, dtype=torch.bool)
    for _, mask in choice.rows:
        yield mask.to(splats.means.device)
    for corners in choice.box3d:
        low, high = torch.tensor(corners).view(2, 3)
        yield in_box(splats, low, high)
    for view, (*place, radius) in choice.sphere:
        if view:
            x, y = place
            centre = surface_point(splats, _camera(scene, view), (x, y))
        else:
            centre = torch.tensor(place)
        yield in_sphere(splats, centre, radius)


def _recorded(key: str, value: Any) -> Any:
    """What `objects.json` records of a choice."""
    if key == "rows":
        return [where for where, _ in value]
    return value[0] if key in ALONE and len(value) == 1 else value


def _resized(scene: Scene, mask: Bool[Tensor, " N"], choice: Choice) -> Bool[Tensor, " N"]:
    if choice.grow is not None:
        return grow(scene.splats, mask, choice.grow)
    return mask if choice.shrink is None else shrink(scene.splats, mask, choice.shrink)


def _camera(scene: Scene, view: str) -> Cameras:
    return scene.cameras[scene.cameras.index(view)]


WHOLE = frozenset({"all", "background"})  # selections with these are no objects beside others


def background_of(
    scene: Scene, name: str | None = None, *, threshold: float = THRESHOLD
) -> Bool[Tensor, " N"]:
    """The Gaussians that belong to no object.

    Objects are those of the label ids; in a scene without label ids, those that have a name.

    Args:
        scene: The scene.
        name: An object that does not count.
        threshold: Probability of an object above which a Gaussian belongs to it.

    Raises:
        StyleSplatError: If there are neither label ids nor names, or nothing is left.
    """
    if scene.splats.classifier is not None:
        ids = object_ids(scene.splats)
        found = each_object(scene.splats, ids, threshold=threshold, remove_outliers=False)
        masks = (picked for _, picked in found)
    else:
        masks = (
            each.picked
            for other, each in scene.objects.items()
            if other != name and not WHOLE & each.how.keys()
        )
    left = None
    for picked in masks:
        left = ~picked if left is None else left & ~picked
    if left is None:
        raise StyleSplatError(
            "The scene has no objects, so all of it is background. Select it with --all, or name "
            "objects first."
        )
    if not left.any():
        raise StyleSplatError("Every Gaussian belongs to an object. Nothing is background.")
    return left
