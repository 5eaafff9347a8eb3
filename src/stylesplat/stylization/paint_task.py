"""The objects of a recipe, each with its network, its Gaussians and its place in the stack."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast, get_args

from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.scene.layer import Layer, Source, on_device
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import find_objects
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.features.weights import load_weights
from stylesplat.stylization.paint_objects import check_jobs
from stylesplat.stylization.style import Recipe, Style, StyledObject, digest
from stylesplat.stylization.style_config import Network, Precision
from stylesplat.stylization.style_job import StyleJob


@dataclass(frozen=True)
class PaintTask:
    """One object to paint."""

    name: str
    """A name, or a label id."""
    style: Style
    """What the object is to look like."""
    styles: tuple[Float[Tensor, "_ _ 3"], ...]
    """The style images, as they are used."""
    picked: Bool[Tensor, " N"]
    """The rows of the base that are the object."""
    features: Network
    """The network whose features are matched."""
    weights: Source | None
    """The network's file; None for its own."""
    precision: Precision | None
    """The precision of the features; None takes the fastest."""

    def job(self, family: Int[Tensor, " M"]) -> StyleJob:
        """The job among Gaussians that belong to these rows of the base."""
        return StyleJob(self.name, self.picked[family], self.styles, self.style.config)

    def recorded(self, layer: Layer, precision: Precision) -> Layer:
        """The layer on the CPU, with all that it takes to paint it again."""
        weights = self.weights
        if weights is not None and weights.path is not None:
            path = weights.path.resolve()
            weights = Source(path, weights.sha256 or digest(path))
        return replace(
            on_device(layer, "cpu"),
            styles=self.style.sources(),
            features=self.features,
            weights=weights,
            precision=precision,
        )


def paint_tasks(
    recipe: Recipe, scene: Scene, features: Network | None, weights: Path | str | None
) -> list[PaintTask]:
    """The objects of a recipe, the lowest layer first: those that are painted, then new ones.

    Raises:
        StyleSplatError: If the scene lacks an object, one is too small, a picture is unfit, or the
            weights are to be those of several networks.
    """
    if not recipe.objects:
        raise StyleSplatError("Nothing to stylise: name at least one object and its style.")
    networks = {features or _network(each) for each in recipe.objects}
    if weights and len(networks) > 1:
        raise StyleSplatError(
            f"{weights} is the file of one network, but the recipe has "
            f"{' and '.join(sorted(networks))}. Pass --features too, or write `weights:` into the "
            "recipe's objects."
        )
    picks = find_objects(scene, [each.name for each in recipe.objects])
    count, places = len(scene.unpainted), _places(scene)
    tasks = [
        PaintTask(
            name=each.name,
            style=each.style,
            styles=each.style.read(),
            picked=picks[each.name][:count].cpu(),
            features=features or _network(each),
            weights=_weights(each, features, weights),
            precision=each.precision,
        )
        for each in recipe.objects
    ]
    check_jobs([StyleJob(each.name, each.picked, (), each.style.config) for each in tasks])
    return sorted(tasks, key=lambda task: places.get(task.name, len(places)))


def load_network(
    styles: Sequence[Style],
    features: str,
    weights: Source | None,
    *,
    download: bool = True,
) -> FeatureNetwork:
    """The network that some styles need, as deep as the deepest does.

    Raises:
        StyleSplatError: As `load_weights` does, or if the file is not the one that was meant.
    """
    path = weights.path if weights else None
    if weights and path and weights.sha256 and path.is_file() and digest(path) != weights.sha256:
        raise StyleSplatError(
            f"{path} holds other weights than those that were used: its digest differs. Put the "
            "file back, or pass --weights."
        )
    check_choice(features, "feature network", get_args(Network))
    depth = max(max(style.config.layers) for style in styles)
    return load_weights(cast("Network", features), path, depth=depth, download=download)


def _places(scene: Scene) -> Mapping[str, int]:
    """The places of the layers in the stack, by the names of their objects."""
    return {name: place for place, name in enumerate(scene.painted_objects)}


def _network(each: StyledObject) -> Network:
    """The network that an object asks for."""
    return each.features or each.style.network


def _weights(
    each: StyledObject, features: Network | None, weights: Path | str | None
) -> Source | None:
    if weights:
        return Source(Path(weights))
    other = features is not None and features != _network(each)
    return None if other else each.weights  # the recipe's file is of its own network
