"""What is painted: objects and their styles, planned by a recipe, and what they have in common."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast, get_args

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import RELIEF_FORM, Source, check_layer_name, split_name
from stylesplat.scene.scene import Scene
from stylesplat.scene.sequences import GIB
from stylesplat.scene.splats import Splats
from stylesplat.selection.resolve import find_objects
from stylesplat.stylization.config import DEFAULT_NETWORK, Network, Precision, StyleConfig
from stylesplat.stylization.features import FeatureNetwork, fastest_dtype, load_weights
from stylesplat.stylization.style import Recipe, Style, digest

MIN_GAUSSIANS = 50  # fewer cannot show a texture
MAX_MEMORY = 1.5  # GiB of linear views; with all else it stays below 3


@dataclass(frozen=True, eq=False)
class Painting:
    """One object to paint and the style that it is to have."""

    name: str
    """The name of its layer: the object's, or with a label behind it ("vase/2")."""
    mask: Bool[Tensor, " N"]
    images: tuple[Float[Tensor, "_ _ 3"], ...]
    """The style images, colours in 0..1; each feature takes the best match of all."""
    config: StyleConfig
    protected: Bool[Tensor, " B"] | None = None
    """Gaussians without the canvas, not of the mask, that no disc of it may cover."""
    style: Style | None = None
    """Where the images come from, which layers record."""
    features: Network = DEFAULT_NETWORK
    weights: Source | None = None
    """The network's file; None for its own."""
    precision: Precision | None = None
    """Of the features; None takes what is fastest on the machine."""
    parents: Int[Tensor, " B"] | None = None
    """The row of the scene's base that each Gaussian without the canvas belongs to; None if these
    are the base's."""

    def to(self, splats: Splats) -> "Painting":
        """The same on the device of the splats."""
        images = tuple(image.to(splats.means) for image in self.images)
        moved = {n: t.to(splats.device) for n, t in vars(self).items() if isinstance(t, Tensor)}
        return replace(self, images=images, **moved)

    def at(self, rows: Int[Tensor, " M"]) -> "Painting":
        """The same among other Gaussians, which belong to these rows."""
        protected = None if self.protected is None else self.protected[rows]
        parents = rows if self.parents is None else self.parents[rows]
        return replace(self, mask=self.mask[rows], protected=protected, parents=parents)


@dataclass(frozen=True, eq=False)
class PaintSetup:
    """The scene and network with which objects are painted."""

    splats: Splats
    """The scene before."""
    cameras: Cameras
    """Views to optimise on."""
    all_cameras: Cameras
    """These and the held-out ones."""
    network: FeatureNetwork
    """In float32."""
    precision: torch.dtype
    """Of the features while optimising."""
    max_memory: float
    """Bytes that linear views may take."""

    @property
    def held_out(self) -> Cameras:
        """Views that are not optimised on, possibly none."""
        return self.all_cameras[len(self.cameras) :]

    @property
    def precision_name(self) -> Precision:
        """As recipes record it."""
        return "bfloat16" if self.precision == torch.bfloat16 else "float32"


def paint_setup(
    splats: Splats,
    cameras: Cameras,
    network: FeatureNetwork,
    *,
    held_out: Cameras | None = None,
    max_memory: float = MAX_MEMORY,
    precision: Precision | None = None,
) -> PaintSetup:
    """Prepare what painting needs besides its targets.

    Nothing but the object may change in held-out views, too. The memory is that of linear views, in
    GiB; other views are rasterised in every step. The precision is by default the fastest.
    """
    if not max_memory >= 0:
        raise StyleSplatError(f"Cannot keep views in {max_memory} GiB. Pass 0 or more.")
    device = splats.device
    return PaintSetup(
        splats=splats.detach(),
        cameras=cameras,
        all_cameras=cameras if held_out is None else cameras + held_out,
        network=network.to(device),
        precision=getattr(torch, precision) if precision else fastest_dtype(device.type),
        max_memory=max_memory * GIB,
    )


def plan_paintings(
    recipe: Recipe, scene: Scene, features: Network | None, weights: Path | str | None
) -> list[Painting]:
    """The objects of a recipe, the lowest layer first: those that are painted, then new ones.

    Their masks are of the scene's base.
    """
    protects = [name for each in recipe.objects for name in each.style.config.protect]
    for each in recipe.objects:
        check_layer_name(each.name)
    objects = {each.name: split_name(each.name)[0] for each in recipe.objects}
    masks = find_objects(scene, [*objects.values(), *protects])
    paintings = list[Painting]()
    for each in recipe.objects:
        own, config = each.features or each.style.network, each.style.config
        mask, protected = masks[objects[each.name]].cpu(), None
        if config.protect:
            protected = torch.stack([masks[name].cpu() for name in config.protect]).any(dim=0)
            mask = mask & ~protected
            if not mask.any():
                raise StyleSplatError(
                    f"Cannot stylise {each.name}: all of it is protected "
                    f"({', '.join(config.protect)})."
                )
        file = each.weights if features in (None, own) else None  # it is of its own network
        painting = Painting(
            name=each.name,
            mask=mask,
            images=each.style.read(),
            config=config,
            protected=protected,
            style=each.style,
            features=features or own,
            weights=Source(Path(weights)) if weights else file,
            precision=each.precision,
        )
        paintings.append(painting)
    networks = sorted({each.features for each in paintings})
    if weights and len(networks) > 1:
        raise StyleSplatError(
            f"{weights} is the file of one network, but the recipe has {' and '.join(networks)}. "
            "Pass --features too, or write `weights:` into the recipe's objects."
        )
    if paintings or not recipe.recolors:
        check_paintings(paintings)
    order = [*(each.name for each in scene.layers), *(each.name for each in paintings)]
    return sorted(paintings, key=lambda each: order.index(each.name))


def check_paintings(paintings: Sequence[Painting]) -> None:
    """Raise a StyleSplatError if these objects cannot be painted in one scene."""
    if not paintings:
        raise StyleSplatError("Nothing to stylise: name at least one object and its style.")
    names = [each.name for each in paintings]
    for each in paintings:
        count = int(each.mask.sum())
        if count < MIN_GAUSSIANS:
            raise StyleSplatError(
                f"Cannot stylise {each.name}: it has {count} Gaussians, too few for a texture "
                f"(at least {MIN_GAUSSIANS}). Pick more of it."
            )
        if names.count(each.name) > 1:
            raise StyleSplatError(
                f"{each.name} was given twice. Give it once; several pictures make one style: "
                f"{each.name}=a.jpg,b.jpg."
            )


def with_relief_form(config: StyleConfig) -> StyleConfig:
    """The settings to paint with: a form above 1 changes the finished paint alone; see `sculpt`."""
    return config if config.form <= RELIEF_FORM else replace(config, form=RELIEF_FORM)


def load_network(
    features: str, weights: Source | None, *, depth: int, download: bool = True
) -> FeatureNetwork:
    """Load the blocks of a network up to `depth`; from a file of the digest recorded."""
    path = weights.path if weights else None
    if weights and path and weights.sha256 and path.is_file() and digest(path) != weights.sha256:
        raise StyleSplatError(
            f"{path} holds other weights than those that were used: its digest differs. Put the "
            "file back, or pass --weights."
        )
    check_choice(features, "feature network", get_args(Network))
    return load_weights(cast("Network", features), path, depth=depth, download=download)


def setup_maker(
    paintings: Sequence[Painting], scene: Scene, max_memory: float, device: torch.device
) -> Callable[[Scene, Painting], tuple[PaintSetup, Painting]]:
    """Returns a function that makes what painting needs on some layers of a scene.

    With it comes the painting among the Gaussians there. Each network is loaded once, as deep as
    the paintings need it.
    """
    depths = dict[tuple[Network, Source | None], int]()
    for each in paintings:
        kind = each.features, each.weights
        depths[kind] = max(each.config.block, depths.get(kind, 0))
    networks = {kind: load_network(*kind, depth=depth) for kind, depth in depths.items()}
    cameras, held_out = scene.working_views()

    def setup_on(below: Scene, painting: Painting) -> tuple[PaintSetup, Painting]:
        setup = paint_setup(
            below.splats.to(device),
            cameras,
            networks[painting.features, painting.weights],
            held_out=held_out,
            max_memory=max_memory,
            precision=painting.precision,
        )
        return setup, painting.at(below.parents).to(setup.splats)

    return setup_on
