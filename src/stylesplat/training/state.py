"""What a training run carries from step to step, and what stays the same throughout."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field, replace
from datetime import timedelta
from typing import Any

import numba
import torch
import torch.distributed as dist
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import track
from stylesplat.rendering.at_once import RenderPool
from stylesplat.rendering.render import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Classifier, Splats
from stylesplat.scene.world_offset import ORIGIN, Offset
from stylesplat.training.adam import Moments
from stylesplat.training.densification import Optimizers, Params, Strategy
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import TrainingView, TrainingViews

PATIENCE = timedelta(days=7)  # of processes for each other: torchrun ends all when one fails
CLASSIFIER = ("weight", "bias")
PER_PHOTO = ("color_maps", "pose_shifts")  # one row per training photo; no part of the splat
STRIDE = 1_000_003  # a prime, so that seeds and steps hardly share random numbers
EPOCHS, NUMBERS, OFFSETS, MOVES, PURPOSES = range(5)  # what randomness is for; how many kinds


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
    """What the strategy remembers; that of `train` remembers nothing."""

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

    def with_own_gradients(self, step: int) -> "State":
        """The state at another step: it shares the tensors, but not their gradients."""
        params = {name: t.detach().requires_grad_() for name, t in self.params.items()}
        return replace(self, params=params, step=step)

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


@dataclass(frozen=True)
class Ranks:
    """Processes that train together, by torch.distributed; each processes photos of its own.

    All begin alike, draw the same random numbers and step by the same averaged gradients, so their
    Gaussians stay the same without being sent.
    """

    number: int = 0  # of this process
    count: int = 1

    @classmethod
    def here(cls) -> "Ranks":
        """The process group that the program has joined; one process without a group."""
        if dist.is_available() and dist.is_initialized():
            return cls(dist.get_rank(), dist.get_world_size())
        return cls()

    @classmethod
    @contextmanager
    def of_torchrun(cls, device: str) -> Iterator["Ranks"]:
        """Join the processes that `torchrun` has started, if any, within the block.

        Each has a GPU of its own, or its share of the cores.
        """
        if "TORCHELASTIC_RUN_ID" not in os.environ or os.environ.get("WORLD_SIZE", "1") == "1":
            yield cls.here()
            return
        number, count = int(os.environ["LOCAL_RANK"]), int(os.environ["LOCAL_WORLD_SIZE"])
        if pick_device(device).type == "cuda":
            gpus = torch.cuda.device_count()
            if count > gpus:
                raise StyleSplatError(
                    f"There are {count} processes for {gpus} GPUs. Give torchrun "
                    f"`--nproc-per-node {gpus}`, or train with `--device cpu`."
                )
            torch.cuda.set_device(number)
            backend = "nccl"
        else:
            backend = "gloo"
            share = max(1, numba.get_num_threads() // count)
            numba.set_num_threads(share)
            torch.set_num_threads(share)
        dist.init_process_group(backend, timeout=PATIENCE)
        try:
            yield cls.here()
        finally:
            dist.destroy_process_group()

    def add_up(self, tensors: Iterable[Tensor]) -> None:
        """Replace each tensor by its sum over all processes; shapes are the same everywhere."""
        if self.count > 1:
            works = [dist.all_reduce(each, async_op=True) for each in tensors]
            for work in works:
                assert work is not None
                work.wait()

    def meet(self) -> None:
        """Wait for all processes."""
        if self.count > 1:
            dist.barrier()

    def largest(self, *numbers: float | int) -> list[float]:
        """The largest of each number over all processes."""
        if self.count == 1:
            return [float(each) for each in numbers]
        device = "cuda" if dist.get_backend() == "nccl" else "cpu"
        maxima = torch.tensor(numbers, dtype=torch.float64, device=device)
        dist.all_reduce(maxima, dist.ReduceOp.MAX)
        return maxima.tolist()


ALONE = Ranks()


@dataclass(frozen=True, eq=False)
class Run:
    """What stays the same in the course of training."""

    config: TrainConfig
    rows: tuple[int, ...]
    """Photos to train on."""
    views: TrainingViews
    """Loads them."""
    cameras: Cameras
    """Of all photos."""
    extent: float
    """Unit of length of the scene."""
    device: torch.device
    strategy: Strategy
    """Moves, adds and removes Gaussians."""
    batch: int = 1
    """Photos of a round: their gradients are computed together, before the first step."""
    ranks: Ranks = ALONE
    """Which process this is; each has as many photos in a round."""
    pool: RenderPool = field(default_factory=lambda: RenderPool(1))
    """The threads that compute gradients."""

    def progress(self, state: State) -> float:
        return self.config.progress(state.step, state.seconds)

    def photos(self, state: State) -> range:
        """Steps of the next round that are this process's; `row` gives the photo of each."""
        own, number, count = self.batch, self.ranks.number, self.ranks.count
        if self.config.max_seconds is None:
            own = max(1, min(own, -(-(self.config.steps - state.step) // count)))
        return range(state.step + number, state.step + own * count, count)

    def every(self, rounds: int, step: int) -> bool:
        """Whether a step is in every n-th round; all processes agree on it."""
        first = step - self.ranks.number  # the same step of the first process
        return first // (self.batch * self.ranks.count) % rounds == 0

    def row(self, step: int) -> int:
        """The photo of a step: every photo once, in random order, then all over again."""
        epoch, place = divmod(step, len(self.rows))
        shuffle = _generator(self.config.seed, EPOCHS, epoch, torch.device("cpu"))
        return self.rows[int(torch.randperm(len(self.rows), generator=shuffle)[place])]

    def all_views(self, what: str, progress: float) -> Iterator[TrainingView]:
        """The photos to train on, of the size at that point of the run, in main memory."""
        for row in track(self.rows, what):
            view = self.views(row, self.config.photo_downscale(progress, self.cameras[row].size))
            alpha, valid = (None if t is None else t.cpu() for t in (view.alpha, view.valid))
            yield view._replace(photo=view.photo.cpu(), alpha=alpha, valid=valid)

    def generator(self, step: int, purpose: int = NUMBERS) -> torch.Generator:
        """Randomness of one step, on the device; it follows from seed and step alone."""
        return _generator(self.config.seed, purpose, step, self.device)

    def offset(self, step: int) -> tuple[int, int]:
        """The first row and column of the pixels whose identities a step samples."""
        # The CPU draws it, so that nothing waits for the device
        draw = _generator(self.config.seed, OFFSETS, step, torch.device("cpu"))
        y, x = torch.randint(self.config.identity_stride, (2,), generator=draw).tolist()
        return y, x


def _generator(seed: int, purpose: int, number: int, device: torch.device) -> torch.Generator:
    mixed = (seed * STRIDE + number) * PURPOSES + purpose
    return torch.Generator(device).manual_seed(mixed % 2**63)
