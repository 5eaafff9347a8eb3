"""What training carries from step to step, and its checkpoint on disk."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import atomic_path
from stylesplat.scene.splats import Classifier, Splats
from stylesplat.training.adam import Moments
from stylesplat.training.train_config import TrainConfig

CLASSIFIER = ("weight", "bias")


@dataclass(frozen=True)
class State:
    """Trained tensors with their optimiser state, after a number of steps."""

    params: dict[str, Tensor]
    """Tensors of `Splats` by name, and the classifier's `weight` and `bias`."""
    moments: Moments
    """Of Adam."""
    ids: tuple[int, ...]
    """Label id of each class; empty without label maps."""
    first_count: int
    """Gaussians at the start."""
    step: int = 0
    """Steps done."""
    seconds: float = 0.0
    """Time they took."""

    @property
    def names(self) -> tuple[str, ...]:
        """The tensors that have one row per Gaussian."""
        return tuple(name for name in self.params if name not in CLASSIFIER)

    def clone(self) -> "State":
        """A copy that shares no tensors."""
        params = {name: t.detach().clone().requires_grad_() for name, t in self.params.items()}
        return replace(self, params=params, moments=self.moments.clone())

    @property
    def splats(self) -> Splats:
        """The Gaussians as they are now, attached to the trained tensors."""
        classifier = None
        if self.ids:
            classifier = Classifier(self.params["weight"], self.params["bias"], self.ids)
        return Splats(**{n: self.params[n] for n in self.names}, classifier=classifier)


def first_state(splats: Splats) -> State:
    """The state before the first step."""
    params = splats.tensors()
    if splats.classifier:
        params |= {"weight": splats.classifier.weight, "bias": splats.classifier.bias}
    params = {name: t.detach().clone().requires_grad_() for name, t in params.items()}
    ids = splats.classifier.ids if splats.classifier else ()
    return State(params, Moments.zeros(params), ids, len(splats))


def save_checkpoint(path: Path, state: State, config: TrainConfig, random: Tensor) -> None:
    """Write everything that `load_checkpoint` needs; whole or not at all."""
    content = {
        "params": {name: t.detach() for name, t in state.params.items()},
        "first": state.moments.first,
        "second": state.moments.second,
        "ids": list(state.ids),
        "counts": [state.first_count, state.step],
        "seconds": state.seconds,
        "config": asdict(config),
        "random": random,
    }
    with atomic_path(path) as temporary:
        torch.save(content, temporary)


def load_checkpoint(path: Path, config: TrainConfig, device: torch.device) -> tuple[State, Tensor]:
    """The state that `save_checkpoint` wrote, and the state of the random generator.

    Raises:
        StyleSplatError: If the file is damaged or belongs to a run with other settings.
    """
    try:
        content = torch.load(path, map_location=device, weights_only=True)
        saved = content["config"]
    except Exception as error:  # torch.load raises half a dozen kinds
        raise StyleSplatError(
            f"Cannot continue from {path}: it is not a checkpoint. Delete it to start afresh."
        ) from error
    changed = [name for name, value in asdict(config).items() if saved.get(name) != value]
    if changed:
        raise StyleSplatError(
            f"{path} is from a run with another {', '.join(changed)}. "
            "Use the same settings to continue, or --overwrite to start afresh."
        )
    params = {name: t.requires_grad_() for name, t in content["params"].items()}
    moments = Moments(content["first"], content["second"])
    first_count, step = content["counts"]
    state = State(params, moments, tuple(content["ids"]), first_count, step, content["seconds"])
    return state, content["random"].cpu()
