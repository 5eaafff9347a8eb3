"""What training carries from step to step."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from stylesplat.scene.splats import Classifier, Splats
from stylesplat.training.adam import Moments

CLASSIFIER = ("weight", "bias")
PER_PHOTO = ("color_maps", "pose_shifts")  # one row per training photo; no part of the splat


@dataclass(frozen=True)
class State:
    """Trained tensors with their optimiser state, after a number of steps."""

    params: dict[str, Tensor]
    """Tensors of `Splats` by name, the classifier's `weight` and `bias`, and `PER_PHOTO` ones."""
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
        return tuple(name for name in self.params if name not in CLASSIFIER + PER_PHOTO)

    def clone(self) -> "State":
        """A copy that shares no tensors."""
        params = {name: t.detach().clone().requires_grad_() for name, t in self.params.items()}
        return replace(self, params=params, moments=self.moments.clone())

    def beside(self, step: int) -> "State":
        """The same tensors, whose gradients are its own, at another step."""
        params = {name: t.detach().requires_grad_() for name, t in self.params.items()}
        return replace(self, params=params, step=step)

    def with_photos(self, tensors: dict[str, Tensor]) -> "State":
        """With what is learned of each photo, by name; before the first step."""
        fresh = {name: t.detach().clone().requires_grad_() for name, t in tensors.items()}
        moments = Moments.zeros(fresh)
        return replace(
            self,
            params=self.params | fresh,
            moments=Moments(
                self.moments.first | moments.first, self.moments.second | moments.second
            ),
        )

    @property
    def splats(self) -> Splats:
        """The Gaussians as they are now, attached to the trained tensors."""
        classifier = None
        if self.ids:
            classifier = Classifier(self.params["weight"], self.params["bias"], self.ids)
        return Splats(**{n: self.params[n] for n in self.names}, classifier=classifier)


def first_state(splats: Splats) -> State:
    """The state before the first step, in contiguous tensors."""
    params = splats.tensors()
    if splats.classifier:
        params |= {"weight": splats.classifier.weight, "bias": splats.classifier.bias}
    params = {
        name: t.detach().clone(memory_format=torch.contiguous_format).requires_grad_()
        for name, t in params.items()
    }
    ids = splats.classifier.ids if splats.classifier else ()
    return State(params, Moments.zeros(params), ids, len(splats))
