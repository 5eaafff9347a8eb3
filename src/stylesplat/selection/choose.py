"""Which Gaussians are meant: objects by id, pixels, words and shapes, united, less what is not."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.compose import family, mask_of
from stylesplat.scene.pasted import pasted
from stylesplat.scene.scene import Scene, SceneObject, is_id
from stylesplat.selection.detector import Detector
from stylesplat.selection.identities import object_ids
from stylesplat.selection.margins import grow, shrink
from stylesplat.selection.pick import (
    THRESHOLD,
    Box,
    Point,
    each_object,
    pick,
    pick_objects,
    resolve_ids,
)
from stylesplat.selection.rest import rest
from stylesplat.selection.shapes import in_box, in_sphere, surface_point
from stylesplat.selection.text import clear_winner, rank_objects

# Selections with these are not the whole object
SHAPING = frozenset(
    {"plus", "minus", "box3d", "sphere", "rows", "all", "background", "grow", "shrink"}
)
ALONE = frozenset({"text", "box3d", "sphere"})  # no list in objects.json where there is one


@dataclass(frozen=True)
class Choice:
    """Which Gaussians are meant: all that is named, less what is taken away."""

    ids: tuple[int, ...] = ()
    """Label ids."""
    boxes: tuple[tuple[str, Box], ...] = ()
    """A view and a rectangle of its pixels: the object that shows most inside."""
    points: tuple[tuple[str, Point], ...] = ()
    """A view and a pixel: the object that shows there."""
    not_points: tuple[tuple[str, Point], ...] = ()
    """Objects that are not meant."""
    text: tuple[str, ...] = ()
    """A few words: the object that they mean. And others."""
    box3d: tuple[tuple[float, ...], ...] = ()
    """Two corners in the world, the lower one first."""
    sphere: tuple[tuple[str, tuple[float, ...]], ...] = ()
    """A centre in the world and a radius; or a view, the pixel that shows the centre, a radius."""
    rows: tuple[tuple[str, Bool[Tensor, " N"]], ...] = ()
    """Gaussians that somebody listed, and where."""
    plus: tuple[str, ...] = ()
    """Earlier names that are part of it."""
    minus: tuple[str, ...] = ()
    """Earlier names that are not."""
    all: bool = False
    """Everything."""
    background: bool = False
    """What belongs to no object."""
    grow: float | None = None
    """Share of its extent by which to grow what was chosen by all that is above."""
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
    """How the Gaussians of an object are told from others."""

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
    """Pick the Gaussians that are meant.

    Args:
        scene: Where they are.
        choice: Which.
        name: What they will be called; what is called so now is no other object.
        rules: How they are told from others.
        detector: What finds `choice.text`.

    Raises:
        StyleSplatError: If the scene has no such object, the text means none or several, or
            nothing is left.
    """
    without = _ids_at(scene, choice.not_points)
    masks = [*_shapes(scene, choice), *(find_object(scene, each) for each in choice.plus)]
    if choice.background:
        masks.append(rest(scene, name, threshold=rules.threshold))
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
            "Nothing says which Gaussians. Say it with --id, --point, --box, --text, --box3d, "
            "--sphere, --rows, --plus, --all or --background; --not-point only takes away."
        )
    mask = torch.stack(masks).any(dim=0)
    for each in _taken_away(scene, choice, without, rules.threshold):
        mask &= ~each
    if not mask.any():
        raise StyleSplatError("Nothing is left of the selection. Take away less.")
    mask = _resized(scene, mask, choice)
    how: dict[str, Any] = {"ids": list(ids), "threshold": rules.threshold}
    how |= {"gaussians": int(mask.sum())}
    given = {key: value for key, value in asdict(choice).items() if value and key != "ids"}
    how |= {key: _said(key, value) for key, value in given.items()}
    return SceneObject(mask, how | ({"scores": scores} if scores else {}))


def find_object(scene: Scene, name: str) -> Bool[Tensor, " N"]:
    """The Gaussians that a name or a label id means.

    Gaussians of layers belong to the objects of their parents; a name that only a layer has means
    what it covers.

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
    """As `find_object` does for each; label ids are looked up together.

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
    """What is picked of the base, and the Gaussians of layers that belong to it."""
    return picked[family(scene).to(picked.device)] if scene.layers else picked


def names_of(scene: Scene, id: int) -> list[str]:
    """What the whole object of a label id is called."""
    return [
        name
        for name, each in scene.objects.items()
        if each.how.get("ids") == [id] and not SHAPING & each.how.keys()
    ]


def whole_ids(scene: Scene, name: str) -> tuple[int, ...]:
    """The label ids of which a name or an id means the whole objects; none if it means others."""
    if name not in scene.objects:
        return (int(name),) if is_id(name) else ()
    how = scene.objects[name].how
    return () if SHAPING & how.keys() else tuple(how.get("ids", ()))


def _taken_away(
    scene: Scene, choice: Choice, without: Sequence[int], threshold: float
) -> Iterator[Bool[Tensor, " N"]]:
    """Gaussians that are not meant, with their strays."""
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
    """The label ids that are named or pointed at."""
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
    """How well a text fits each object that may be meant, as it looks without a style."""
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


def _said(key: str, value: Any) -> Any:
    """What is written down of a choice."""
    if key == "rows":
        return [where for where, _ in value]
    return value[0] if key in ALONE and len(value) == 1 else value


def _resized(scene: Scene, mask: Bool[Tensor, " N"], choice: Choice) -> Bool[Tensor, " N"]:
    if choice.grow is not None:
        return grow(scene.splats, mask, choice.grow)
    return mask if choice.shrink is None else shrink(scene.splats, mask, choice.shrink)


def _camera(scene: Scene, view: str) -> Cameras:
    return scene.cameras[scene.cameras.index(view)]
