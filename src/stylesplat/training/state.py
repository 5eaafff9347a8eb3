"""What a training run carries from step to step, and what stays the same throughout."""

from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.progress import track
from stylesplat.rendering.view_pool import RenderPool
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Classifier, Splats
from stylesplat.scene.world_offset import ORIGIN, Offset
from stylesplat.training.adam import Moments
from stylesplat.training.config import TrainConfig
from stylesplat.training.densification import Optimizers, Params, Strategy, sound_rows
from stylesplat.training.views import TrainingView, TrainingViews

CLASSIFIER = ("weight", "bias")
PER_PHOTO = ("color_maps", "pose_shifts")  # one row per training photo; no part of the splat
SEED_STRIDE = 1_000_003  # a prime, so that seeds and steps hardly share random numbers


class RandomStream(IntEnum):
    """What random numbers are for; each use has its own."""

    EPOCH = 0
    STEP = 1
    OFFSET = 2
    MOVE = 3


@dataclass(frozen=True, eq=False)
class State:
    """Trained tensors with their optimiser state, after a number of steps."""

    params: dict[str, Tensor]
    """Tensors of `Splats` by name, the classifier's `weight` and `bias`, and `PER_PHOTO` ones."""
    moments: Moments
    ids: tuple[int, ...]
    """Label id of each class; empty without label maps."""
    first_count: int
    """Gaussians at the start."""
    step: int = 0
    """Steps done."""
    seconds: float = 0.0
    """Time they took."""
    world_offset: Offset = ORIGIN
    """What the Gaussians are relative to, as the capture is."""
    strategy_state: dict[str, Any] = field(default_factory=dict)
    """What the strategy remembers."""

    @property
    def names(self) -> tuple[str, ...]:
        """The tensors that have one row per Gaussian."""
        return tuple(name for name in self.params if name not in CLASSIFIER + PER_PHOTO)

    def clone(self) -> "State":
        params = {name: t.detach().clone().requires_grad_() for name, t in self.params.items()}
        remembered = deepcopy(self.strategy_state)
        return replace(self, params=params, moments=self.moments.clone(), strategy_state=remembered)

    def gaussians(self) -> tuple[Params, Optimizers]:
        """The tensors that have one row per Gaussian, and their moments, for a strategy."""
        params = {name: self.params[name] for name in self.names}
        return params, self.moments.optimizers(params)

    def with_gaussians(self, params: Params, optimizers: Optimizers) -> "State":
        """The state with what a strategy has made of `gaussians`."""
        moments = self.moments.updated(optimizers)
        return replace(self, params=self.params | params, moments=moments)

    def detached_copy(self, step: int) -> "State":
        """The state at another step: it shares the tensors, but not their gradients."""
        params = {name: t.detach().requires_grad_() for name, t in self.params.items()}
        return replace(self, params=params, step=step)

    def without_runaways(self) -> "State":
        """The state without the Gaussians that have run away: `sound_rows` rejects them, or their
        moments are not finite. What lies far from everything is never seen, and so never comes
        back."""
        sound = sound_rows(self.params)
        for moments in (self.moments.first, self.moments.second):
            for name in self.names:
                sound = sound & moments[name][:, None].flatten(1).isfinite().all(dim=1)
        return self if sound.all() else self.at_rows(sound)

    def at_rows(self, rows: Bool[Tensor, " N"] | Int[Tensor, " M"]) -> "State":
        """The state of these Gaussians, some perhaps repeated; it shares all other tensors."""
        params = {n: self.params[n].detach()[rows].requires_grad_() for n in self.names}
        first, second = (
            moments | {name: moments[name][rows] for name in self.names}
            for moments in (self.moments.first, self.moments.second)
        )
        params, moments = self.params | params, Moments(first, second)
        return replace(self, params=params, moments=moments, strategy_state={})  # it is of all rows

    def with_photos(self, tensors: dict[str, Tensor]) -> "State":
        """The state with `PER_PHOTO` tensors, before the first step."""
        fresh = {name: t.detach().clone().requires_grad_() for name, t in tensors.items()}
        zeros = Moments.zeros(fresh)
        moments = Moments(self.moments.first | zeros.first, self.moments.second | zeros.second)
        return replace(self, params=self.params | fresh, moments=moments)

    @property
    def splats(self) -> Splats:
        """The Gaussians as they are now, attached to the trained tensors."""
        classifier = None
        if self.ids:
            classifier = Classifier(self.params["weight"], self.params["bias"], self.ids)
        own: dict[str, Any] = {n: self.params[n] for n in self.names}
        return Splats(**own, classifier=classifier, world_offset=self.world_offset)


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
    zeros = Moments.zeros(params)
    return State(params, zeros, ids, len(splats), world_offset=splats.world_offset)


class PhotoGradients(NamedTuple):
    """The gradients of one photo, or the mean of several photos'; nothing waits for the device."""

    state: State
    """The tensors before the round, with these gradients; its step is the first photo's."""
    visible: Bool[Tensor, " N"]
    """Which Gaussians the cameras see."""
    scores: Float[Tensor, "2"]
    """Loss and PSNR."""
    info: dict[str, Any]
    """Of the render, for the strategy; that of one of several photos."""
    photos: int
    """How many photos they are the mean of."""
    learns_identities: bool
    """Whether identities are learned in this round, where the photo has a label map."""


Exchange = Callable[[Sequence[PhotoGradients]], Sequence[PhotoGradients]]
"""Takes the gradients of a process's own photos; returns those to step by."""


@dataclass(frozen=True, eq=False)
class TrainingRun:
    """What stays the same in the course of training."""

    config: TrainConfig
    rows: tuple[int, ...]
    """Photos to train on."""
    views: TrainingViews
    cameras: Cameras
    """Of all photos."""
    extent: float
    """Unit of length of the scene."""
    device: torch.device
    strategy: Strategy
    batch: int = 1
    """Photos of a round: their gradients are computed together, before the first step."""
    pool: RenderPool = field(default_factory=lambda: RenderPool(1))
    """The threads that compute gradients."""
    rank: int = 0
    """Which process this is of those that train together; each takes one photo of a round."""
    processes: int = 1
    exchange: Exchange = tuple

    def progress(self, state: State) -> float:
        return self.config.progress(state.step, state.seconds)

    def own_steps(self, state: State) -> range:
        """The steps of the next round whose photos, by `row`, are this process's."""
        first, count = state.step, self.batch
        if self.processes > 1:
            return range(first + self.rank, first + self.rank + 1)
        if self.config.max_seconds is None:
            count = max(1, min(count, self.config.steps - first))  # one beyond the last, to warm up
        return range(first, first + count)

    def is_due(self, rounds: int, step: int) -> bool:
        """Whether a step is in every n-th round."""
        return step // self.batch % rounds == 0

    def row(self, step: int) -> int:
        """The photo of a step: every photo once, in random order, then all over again."""
        epoch, place = divmod(step, len(self.rows))
        shuffle = _generator(self.config.seed, RandomStream.EPOCH, epoch, torch.device("cpu"))
        return self.rows[int(torch.randperm(len(self.rows), generator=shuffle)[place])]

    def all_views(self, what: str, progress: float) -> Iterator[TrainingView]:
        """The photos to train on, of the size at that point of the run, in main memory."""
        for row in track(self.rows, what):
            view = self.views(row, self.config.photo_downscale(progress, self.cameras[row].size))
            alpha, valid = (None if t is None else t.cpu() for t in (view.alpha, view.valid))
            yield view._replace(photo=view.photo.cpu(), alpha=alpha, valid=valid)

    def generator(self, step: int, stream: RandomStream = RandomStream.STEP) -> torch.Generator:
        """Randomness of one step, on the device; it follows from seed and step alone."""
        return _generator(self.config.seed, stream, step, self.device)

    def offset(self, step: int) -> tuple[int, int]:
        """The first row and column of the pixels whose identities a step samples."""
        # The CPU draws it, so that nothing waits for the device
        draw = _generator(self.config.seed, RandomStream.OFFSET, step, torch.device("cpu"))
        y, x = torch.randint(self.config.identity_stride, (2,), generator=draw).tolist()
        return y, x


def _generator(
    seed: int, stream: RandomStream, number: int, device: torch.device
) -> torch.Generator:
    mixed = (seed * SEED_STRIDE + number) * len(RandomStream) + stream
    return torch.Generator(device).manual_seed(mixed % 2**63)
