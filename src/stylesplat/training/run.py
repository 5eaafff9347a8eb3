"""What stays the same in the course of training."""

from dataclasses import dataclass, field

import torch

from stylesplat.rendering.at_once import Crew
from stylesplat.scene.cameras import Cameras
from stylesplat.training.ranks import ALONE, Ranks
from stylesplat.training.state import State
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import Views

STRIDE = 1_000_003  # a prime, so that seeds and steps hardly share random numbers
EPOCHS, NUMBERS, OFFSETS, MOVES, PURPOSES = range(5)  # what randomness is for; how many kinds


@dataclass(frozen=True)
class Run:
    """What stays the same in the course of training."""

    config: TrainConfig
    """How to train."""
    rows: tuple[int, ...]
    """Photos to train on."""
    views: Views
    """Loads them."""
    cameras: Cameras
    """Of all photos."""
    extent: float
    """Unit of length of the scene."""
    device: torch.device
    """Where to train."""
    batch: int = 1
    """Photos of a round: they are looked at together, before the first one's step is taken."""
    ranks: Ranks = ALONE
    """Which process this is; each has as many photos in a round."""
    crew: Crew = field(default_factory=lambda: Crew(1))
    """Looks at them."""

    def progress(self, state: State) -> float:
        """The share of the run that is done."""
        return self.config.progress(state.step, state.seconds)

    def photos(self, state: State) -> range:
        """Numbers of the photos of the next round that are this process's; see `row`."""
        own, number, count = self.batch, self.ranks.number, self.ranks.count
        if self.config.max_seconds is None:
            own = max(1, min(own, -(-(self.config.steps - state.step) // count)))
        return range(state.step + number, state.step + own * count, count)

    def every(self, rounds: int, step: int) -> bool:
        """Whether a photo is of the first of so many rounds.

        All of a round are, or none, if the run has had the same rounds from its start. In any case
        the processes agree on it photo by photo, as they send each other the same tensors.
        """
        first = step - self.ranks.number  # number of the first process's photo beside it
        return first // (self.batch * self.ranks.count) % rounds == 0

    def row(self, step: int) -> int:
        """The photo of a step: every photo once, in random order, then all over again."""
        epoch, place = divmod(step, len(self.rows))
        shuffle = _generator(self.config.seed, EPOCHS, epoch, torch.device("cpu"))
        return self.rows[int(torch.randperm(len(self.rows), generator=shuffle)[place])]

    def generator(self, step: int, purpose: int = NUMBERS) -> torch.Generator:
        """Randomness of one step, on the device.

        It follows from seed and step alone, so that a run that is continued needs no memory of it.
        """
        return _generator(self.config.seed, purpose, step, self.device)

    def offset(self, step: int) -> tuple[int, int]:
        """The row and column from which on every n-th pixel has its identity looked at.

        Drawn by the program, which so need not wait for the device.
        """
        draw = _generator(self.config.seed, OFFSETS, step, torch.device("cpu"))
        y, x = torch.randint(self.config.identity_stride, (2,), generator=draw).tolist()
        return y, x


def _generator(seed: int, purpose: int, number: int, device: torch.device) -> torch.Generator:
    mixed = (seed * STRIDE + number) * PURPOSES + purpose
    return torch.Generator(device).manual_seed(mixed % 2**63)
