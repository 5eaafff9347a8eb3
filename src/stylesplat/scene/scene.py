"""The `Scene` noun, and the objects of a scene, named or listed."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, brief, check_choice, counted, one_line, some
from stylesplat.scene.cameras import Cameras, pixels
from stylesplat.scene.layer import Layer
from stylesplat.scene.splats import Splats
from stylesplat.scene.world_offset import Offset

Which = Literal["test", "train", "all"]

MAX_NAME = 100  # characters of an object's name
RESERVED = "__metadata__"  # of safetensors files
# Folders, the sign of OBJECT=IMAGE, control characters and line ends, halves of characters
UNFIT = re.compile(r"[/\\=\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A named object."""

    picked: Bool[Tensor, " N"]
    """Its Gaussians."""
    how: Mapping[str, Any] = field(default_factory=dict)
    """How they were selected, as plain values: `ids`, `threshold`, `gaussians` and so on."""

    def with_picked(self, picked: Bool[Tensor, " N"]) -> "SceneObject":
        """The object with other Gaussians."""
        return SceneObject(picked, {**self.how, "gaussians": int(picked.sum())})

    def __repr__(self) -> str:
        named = " ".join(map(str, self.how.get("ids", ())))
        share = f"{int(self.picked.sum()):,} of {counted(len(self.picked), 'Gaussian')}"
        return one_line(self, share, f"label ids {named}" if named else None)


@dataclass(frozen=True, eq=False)
class Scene:
    """Gaussians, the cameras that they were photographed by, named objects, layers of paint.

    Scenes are never changed: every verb takes one and returns another.
    """

    splats: Splats
    """What the scene looks like: the layers composed onto the base. Of degree 3 if it was read."""
    cameras: Cameras
    """All cameras of the capture, at the photos' full size."""
    held_out: tuple[str, ...] = ()
    """Names of the photos that are not trained on but measured."""
    downscale: float = 1.0
    """The factor by which the training views are smaller than the photos."""
    objects: Mapping[str, SceneObject] = field(default_factory=dict)
    """The named objects."""
    base: Splats | None = None
    """The splat beneath all layers; None if there are no layers."""
    layers: tuple[Layer, ...] = ()
    """The stack of layers, the lowest first. `with_layers` changes it."""
    path: Path | None = None
    """The folder that it was opened from."""
    capture: Path | None = None
    """The folder of the photos, also after it was moved together with the scene."""
    info: Mapping[str, Any] = field(default_factory=dict)
    """How it was made, as plain values: settings, versions of libraries."""
    metrics: Mapping[str, Any] = field(default_factory=dict)
    """Measured numbers, as plain values."""

    def __repr__(self) -> str:
        held_out = f" ({len(self.held_out)} held out)" if self.held_out else ""
        return one_line(
            self,
            counted(len(self.splats), "Gaussian"),
            counted(len(self.cameras), "view") + held_out,
            f"objects: {some(self.objects)}" if self.objects else None,
            f"painted: {some(self.painted_objects)}" if self.layers else None,
            self.path,
        )

    def views(self, which: Which = "all") -> Cameras:
        """The cameras of the held-out (test), training or all views, at the photos' size.

        Raises:
            StyleSplatError: If there are none.
        """
        check_choice(which, "set of views", get_args(Which))
        held_out = set(self.held_out)
        rows = [
            row
            for row, name in enumerate(self.cameras.names)
            if which == "all" or (name in held_out) == (which == "test")
        ]
        if not rows:
            raise StyleSplatError(f"The scene has no {which} views. Choose all views, or an orbit.")
        return self.cameras[rows]

    def working_views(self) -> tuple[Cameras, Cameras | None]:
        """Training views, and held-out views if any, at the size that the scene was made at."""
        training = self.views("train").downscale(self.downscale)
        return training, self.views("test").downscale(self.downscale) if self.held_out else None

    @property
    def unpainted(self) -> Splats:
        """The splat beneath all layers. Its rows are the first ones of `splats`."""
        return self.splats if self.base is None else self.base

    @property
    def world_offset(self) -> Offset:
        """What was subtracted from the world's coordinates of the splats and the cameras."""
        return self.splats.world_offset

    @property
    def painted_objects(self) -> tuple[str, ...]:
        """The names of the layers' objects, the lowest first, each once."""
        return tuple(dict.fromkeys(layer.object for layer in self.layers))

    def with_object(self, name: str, found: SceneObject) -> "Scene":
        """The scene with a named object, which replaces an earlier one of that name."""
        check_name(name)
        return replace(self, objects={**self.objects, name: found})


def check_name(name: str) -> None:
    """Refuse a name that no object can have."""
    fault = name_fault(name)
    if fault:
        raise StyleSplatError(
            f"Cannot call an object {brief(name)!r}: {fault}. Choose another name."
        )


def check_name_or_id(name: str) -> None:
    if not is_id(name):
        check_name(name)


def is_id(name: str) -> bool:
    """Whether a name is a label id; `int` refuses thousands of digits."""
    return name.isdecimal() and len(name) <= MAX_NAME


def name_fault(name: str) -> str | None:
    """The reason why no object can have a name, or None."""
    if not name.strip():
        return "a name must not be empty"
    if name.isdecimal():
        return "numbers are label ids"
    if UNFIT.search(name):
        return "names must not contain '=', slashes or control characters"
    if name == RESERVED:
        return "files of objects use that name for themselves"
    return f"names have at most {MAX_NAME} characters" if len(name) > MAX_NAME else None


@dataclass(frozen=True, eq=False)
class ListedObject:
    """The Gaussians of an object by row."""

    rows: Int[Tensor, " M"]
    shares: Float[Tensor, " M"] | None = None
    """The share of each Gaussian that belongs to the object, 0 to 1; None if unknown."""
    ids: tuple[int, ...] = ()
    """Its label ids."""


@dataclass(frozen=True, eq=False)
class ListedObjects:
    """All objects of a splat of `count` Gaussians."""

    count: int
    objects: Mapping[str, ListedObject] = field(default_factory=dict)
    """By name, or by label id if an object has no name."""
    labels: Int[Tensor, " N"] | None = None
    """The label id of each Gaussian, 0 for no object; None if there are none."""

    def ordered(self, order: Int[Tensor, " M"]) -> "ListedObjects":
        """The list for some of the Gaussians in another order; empty objects are dropped."""
        place = torch.full((self.count,), -1)
        place[order] = torch.arange(len(order))
        objects = dict[str, ListedObject]()
        for name, each in self.objects.items():
            rows, indices = place[each.rows].sort()
            indices = indices[rows >= 0]
            if len(indices):
                shares = None if each.shares is None else each.shares[indices]
                objects[name] = replace(each, rows=rows[rows >= 0], shares=shares)
        labels = None if self.labels is None else self.labels[order]
        return ListedObjects(len(order), objects, labels)


def shared_views(scenes: Mapping[str, Scene]) -> tuple[str, ...]:
    """The photos that all scenes have views of: those held out in all, or else any.

    World frames may differ. Views of one name have to agree in size, or else they are of other
    photos.
    """
    (first, one), *others = scenes.items()
    every = [{*scene.cameras.names} for scene in scenes.values()]
    shared = [name for name in one.cameras.names if all(name in names for names in every)]
    if not shared:
        raise StyleSplatError(
            f"No view is in all of {', '.join(scenes)}; {one.cameras.names[0]} is in {first}. "
            "Compare scenes of the same photos."
        )
    mine = one.cameras[[*map(one.cameras.index, shared)]]
    for name, scene in others:
        theirs = scene.cameras[[*map(scene.cameras.index, shared)]]
        differ = (mine.sizes != theirs.sizes).any(dim=1).nonzero()[:, 0].tolist()
        if differ:
            here, there = (pixels(cameras.sizes[differ[:1]]) for cameras in (mine, theirs))
            raise StyleSplatError(
                f"{shared[differ[0]]} is {here} pixels in {first} and {there} in {name}. "
                "Compare scenes of the same photos."
            )
    unseen = [name for name in shared if all(name in each.held_out for each in scenes.values())]
    return tuple(unseen or shared)
