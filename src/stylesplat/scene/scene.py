"""The `Scene` noun: a base, layers of paint upon it, and what it looks like with them."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import torch
from jaxtyping import Bool, Int, Shaped
from torch import Tensor

from stylesplat.errors import (
    StyleSplatError,
    check_choice,
    count_noun,
    join_names,
    noun_repr,
    shell_command,
)
from stylesplat.scene.cameras import Cameras, pixels
from stylesplat.scene.layers import RECOLOR, Composed, Layer, compose
from stylesplat.scene.objects import SceneObject, check_name
from stylesplat.scene.splats import Splats
from stylesplat.scene.world_offset import Offset

ViewSet = Literal["test", "train", "all"]


@dataclass(frozen=True, eq=False)
class Scene:
    """Gaussians, the cameras that they were photographed by, named objects, layers of paint.

    Scenes are never changed: every verb takes one and returns another.
    """

    base: Splats
    """The splat below all layers. Of degree 3 if it was read."""
    cameras: Cameras
    """All cameras of the capture, at the photos' full size."""
    held_out: tuple[str, ...] = ()
    """Names of the photos that are not trained on but measured."""
    downscale: float = 1.0
    """The factor by which the training views are smaller than the photos."""
    objects: Mapping[str, SceneObject] = field(default_factory=dict)
    """The named objects."""
    layers: tuple[Layer, ...] = ()
    """The stack of layers, the lowest first."""
    path: Path | None = None
    """The folder that it was opened from."""
    capture: Path | None = None
    """The folder of the photos, also after it was moved together with the scene."""
    info: Mapping[str, Any] = field(default_factory=dict)
    """How it was made, as plain values: settings, versions of libraries."""
    metrics: Mapping[str, Any] = field(default_factory=dict)
    """Measured numbers, as plain values."""
    composed: Composed | None = None
    """A cache of `splats` and `parents`, which is never wrong: another base or another layer in the
    stack makes it be composed anew."""

    def __repr__(self) -> str:
        held_out = f" ({len(self.held_out)} held out)" if self.held_out else ""
        return noun_repr(
            self,
            count_noun(len(self.splats), "Gaussian"),
            count_noun(len(self.cameras), "view") + held_out,
            f"objects: {join_names(self.objects)}" if self.objects else None,
            f"painted: {join_names(self.painted_objects)}" if self.layers else None,
            self.path,
        )

    @property
    def splats(self) -> Splats:
        """What the scene looks like: the layers composed onto the base, whose rows come first."""
        return self._composed().splats

    @property
    def parents(self) -> Int[Tensor, " N"]:
        """The row of the base that each row of `splats` belongs to."""
        return self._composed().parents

    def _composed(self) -> Composed:
        known = self.composed
        if known is None or known.base is not self.base or known.layers != tuple(self.layers):
            with torch.inference_mode(False):  # what is kept may be trained on later
                known = compose(self.base, self.layers, known)
            object.__setattr__(self, "composed", known)
        return known

    def splats_with_last(self, names: Collection[str]) -> Splats:
        """What the scene looks like, with the surfels of some layers after all other rows."""
        shown = [layer for layer in self.layers if layer.is_shown]
        is_last = [torch.zeros(len(self.base), dtype=torch.bool)]
        is_last += [torch.full_like(each.parents, each.name in names).bool() for each in shown]
        return self.splats[torch.cat(is_last).byte().argsort(stable=True)]

    def to_splats(self, values: Shaped[Tensor, "B *_"]) -> Shaped[Tensor, "N *_"]:
        """Values of the rows of the base, for all rows of `splats`."""
        return values[self.parents.to(values.device)] if self.layers else values

    def to_base(self, values: Shaped[Tensor, "N *_"]) -> Shaped[Tensor, "B *_"]:
        """The sums of the values of all rows of `splats` that belong to each row of the base."""
        sums = values.new_zeros(len(self.base), *values.shape[1:])
        return sums.index_add(0, self.parents.to(values.device), values)

    def most_of(self, mask: Bool[Tensor, " N"]) -> Bool[Tensor, " B"]:
        """The rows of the base of whose Gaussians in `splats` more than half are in a mask."""
        return self.to_base(2 * mask.int() - 1) > 0

    def layer(self, name: str) -> Layer | None:
        """The layer of a name, if there is one."""
        return next((each for each in self.layers if each.name == name), None)

    def below(self, name: str) -> "Scene":
        """The scene under the layer of a name; under a new layer, which goes on top, all of it."""
        names = [each.name for each in self.layers]
        return replace(self, layers=self.layers[: names.index(name)]) if name in names else self

    def with_layer(self, layer: Layer) -> "Scene":
        """The scene with a layer in place of the one of its name, or on top."""
        layers = {each.name: each for each in self.layers} | {layer.name: layer}
        return self.with_layers(layers.values())

    def without_layers(self, names: Collection[str] | None = None) -> "Scene":
        """The scene without the layers of some names, by default without any."""
        if names is not None and not names:
            return self
        require_painted(self, names or ())
        left = [each for each in self.layers if names is not None and each.name not in names]
        train = self.metrics.get("train", {})
        return replace(self.with_layers(left), metrics={"train": train} if left else train)

    def with_strengths(
        self, strengths: Mapping[str, float], forms: Mapping[str, float] | None = None
    ) -> "Scene":
        """The scene with other strengths and forms of some layers, by name."""
        layers = list[Layer]()
        for each in self.layers:
            strength = strengths.get(each.name, each.strength)
            form = (forms or {}).get(each.name, each.form)
            same = (strength, form) == (each.strength, each.form)
            layers.append(each if same else replace(each, strength=strength, form=form))
        return self if tuple(layers) == self.layers else self.with_layers(layers)

    def with_layers(self, layers: Collection[Layer]) -> "Scene":
        """The scene with another stack of layers, which no folder holds."""
        layers, known = tuple(layers), self.composed
        known = known if known and known.is_below(self.base, layers) else None  # it takes memory
        return replace(self, layers=layers, path=None, composed=known)

    def views(self, which: ViewSet = "all") -> Cameras:
        """The cameras of the held-out (test), training or all views, at the photos' size.

        Raises:
            StyleSplatError: If there are none.
        """
        check_choice(which, "set of views", get_args(ViewSet))
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
    def world_offset(self) -> Offset:
        """What was subtracted from the world's coordinates of the splats and the cameras."""
        return self.base.world_offset

    @property
    def painted_objects(self) -> tuple[str, ...]:
        """The names of the layers' objects, the lowest first, each once."""
        return tuple(dict.fromkeys(layer.object for layer in self.layers))

    def with_object(self, name: str, found: SceneObject) -> "Scene":
        """The scene with a named object, which replaces an earlier one of that name."""
        check_name(name)
        return replace(self, objects={**self.objects, name: found})


def strengths_of(scene: Scene) -> dict[str, float]:
    return {each.name: each.strength for each in scene.layers}


def named_layers(scene: Scene, names: Collection[str]) -> list[str]:
    """The layers that names stand for: an object's paint, or what recolours it if it has none."""
    known = strengths_of(scene)
    own = [n if n in known or f"{n}{RECOLOR}" not in known else f"{n}{RECOLOR}" for n in names]
    require_painted(scene, own)
    return own


def require_painted(scene: Scene, names: Collection[str] = ()) -> None:
    """Refuse a scene without layers, or without layers of some names."""
    if not scene.layers:
        way = shell_command(
            "stylize", scene.path or "SCENE", "--style", "OBJECT=IMAGE", "-o", "STYLED"
        )
        raise StyleSplatError(
            f"{scene.path or 'The scene'} is not styled. Style it first: `{way}`."
        )
    known = strengths_of(scene)
    unknown = next((name for name in names if name not in known), None)
    if unknown is not None:
        raise StyleSplatError(
            f"{unknown} is not styled in {scene.path or 'this scene'}. "
            f"Styled objects: {', '.join(known)}."
        )


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
