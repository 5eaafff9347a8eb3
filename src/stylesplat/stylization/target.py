"""What is painted: the objects of a recipe, and what painting them has in common."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast, get_args

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import Layer, Source
from stylesplat.scene.scene import Scene
from stylesplat.scene.sequences import GIB
from stylesplat.scene.splats import Splats
from stylesplat.selection.choose import find_objects
from stylesplat.stylization.config import DEFAULT_NETWORK, Network, Precision, StyleConfig
from stylesplat.stylization.features import FeatureNetwork, fastest_dtype, load_weights
from stylesplat.stylization.style import Recipe, Style, StyledObject, digest

MIN_GAUSSIANS = 50  # fewer cannot show a texture
MAX_MEMORY = 1.5  # GiB of linear views; with all else it stays below 3


@dataclass(frozen=True, eq=False)
class PaintTarget:
    """One object and the style that it is to have."""

    name: str
    mask: Bool[Tensor, " N"]
    styles: tuple[Float[Tensor, "_ _ 3"], ...]
    """The style images, colours in 0..1; each feature takes the best match of all."""
    config: StyleConfig
    protected: Bool[Tensor, " B"] | None = None
    """Gaussians of the scene before, not of the mask, that no disc of a canvas may cover."""

    def to(self, splats: Splats) -> "PaintTarget":
        """The same on the device of the splats."""
        styles = tuple(style.to(splats.means) for style in self.styles)
        protected = self.protected if self.protected is None else self.protected.to(splats.device)
        return replace(self, mask=self.mask.to(splats.device), styles=styles, protected=protected)


@dataclass(frozen=True, eq=False)
class PaintContext:
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
    def precision_name(self) -> Precision:
        """As recipes record it."""
        return "bfloat16" if self.precision == torch.bfloat16 else "float32"


def paint_context(
    splats: Splats,
    cameras: Cameras,
    network: FeatureNetwork,
    *,
    held_out: Cameras | None = None,
    max_memory: float = MAX_MEMORY,
    precision: Precision | None = None,
) -> PaintContext:
    """Prepare what painting needs besides its targets.

    Nothing but the object may change in held-out views, too. The memory is that of linear views, in
    GiB; other views are rasterised in every step. The precision is by default the fastest.
    """
    if not max_memory >= 0:
        raise StyleSplatError(f"Cannot keep views in {max_memory} GiB. Pass 0 or more.")
    device = splats.device
    return PaintContext(
        splats=splats.detach(),
        cameras=cameras,
        all_cameras=cameras if held_out is None else cameras + held_out,
        network=network.to(device),
        precision=getattr(torch, precision) if precision else fastest_dtype(device.type),
        max_memory=max_memory * GIB,
    )


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PaintTask(StyledObject):
    """An object of a recipe with its style images and its rows of the base."""

    features: Network = DEFAULT_NETWORK
    images: tuple[Float[Tensor, "_ _ 3"], ...]
    mask: Bool[Tensor, " B"]
    protected: Bool[Tensor, " B"] | None = None
    """The rows of the base that its style protects."""

    def target(self, parents: Int[Tensor, " M"]) -> PaintTarget:
        """The target among Gaussians that belong to these rows of the base."""
        protected = self.protected if self.protected is None else self.protected[parents]
        return PaintTarget(self.name, self.mask[parents], self.images, self.style.config, protected)

    def record(self, layer: Layer, precision: Precision) -> Layer:
        """The layer on the CPU, with all that it takes to paint it again."""
        weights = self.weights
        if weights is not None and weights.path is not None:
            path = weights.path.resolve()
            weights = Source(path, weights.sha256 or digest(path))
        return replace(
            layer.to("cpu"),
            styles=self.style.sources(),
            features=self.features,
            weights=weights,
            precision=precision,
        )


def paint_tasks(
    recipe: Recipe, scene: Scene, features: Network | None, weights: Path | str | None
) -> list[PaintTask]:
    """The objects of a recipe, the lowest layer first: those that are painted, then new ones."""
    protects = [name for each in recipe.objects for name in each.style.config.protect]
    masks = find_objects(scene, [*(each.name for each in recipe.objects), *protects])
    tasks = list[PaintTask]()
    for each in recipe.objects:
        own = each.features or each.style.network
        changed = {
            "features": features or own,
            "weights": each.weights if features in (None, own) else None,  # it is of its own
            "images": each.style.read(),
            "mask": masks[each.name].cpu(),
        }
        if protect := each.style.config.protect:
            protected = torch.stack([masks[name].cpu() for name in protect]).any(dim=0)
            changed |= {"mask": changed["mask"] & ~protected, "protected": protected}
            if not changed["mask"].any():
                raise StyleSplatError(
                    f"Cannot stylise {each.name}: all of it is protected ({', '.join(protect)})."
                )
        if weights:
            changed["weights"] = Source(Path(weights))
        tasks.append(PaintTask(**vars(each) | changed))
    networks = sorted({task.features for task in tasks})
    if weights and len(networks) > 1:
        raise StyleSplatError(
            f"{weights} is the file of one network, but the recipe has {' and '.join(networks)}. "
            "Pass --features too, or write `weights:` into the recipe's objects."
        )
    if tasks or not recipe.recolors:
        check_targets(tasks)
    painted = [*(each.name for each in scene.layers), *(task.name for task in tasks)]
    return sorted(tasks, key=lambda task: painted.index(task.name))


def check_targets(targets: Sequence[PaintTarget | PaintTask]) -> None:
    """Raise a StyleSplatError if these objects cannot be painted in one scene."""
    if not targets:
        raise StyleSplatError("Nothing to stylise: name at least one object and its style.")
    names = [target.name for target in targets]
    for target in targets:
        count = int(target.mask.sum())
        if count < MIN_GAUSSIANS:
            raise StyleSplatError(
                f"Cannot stylise {target.name}: it has {count} Gaussians, too few for a texture "
                f"(at least {MIN_GAUSSIANS}). Pick more of it."
            )
        if names.count(target.name) > 1:
            raise StyleSplatError(
                f"{target.name} was given twice. Give it once; several pictures make one style: "
                f"{target.name}=a.jpg,b.jpg."
            )


def load_network(
    styles: Sequence[Style], features: str, weights: Source | None, *, download: bool = True
) -> FeatureNetwork:
    """Load a network as deep as some styles need it; from a file of the digest recorded."""
    path = weights.path if weights else None
    if weights and path and weights.sha256 and path.is_file() and digest(path) != weights.sha256:
        raise StyleSplatError(
            f"{path} holds other weights than those that were used: its digest differs. Put the "
            "file back, or pass --weights."
        )
    check_choice(features, "feature network", get_args(Network))
    depth = max(style.config.block for style in styles)
    return load_weights(cast("Network", features), path, depth=depth, download=download)
