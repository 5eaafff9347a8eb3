"""Processes that train together: each looks at photos of its own, and all take the same steps.

Gradients are averaged by torch.distributed, whose process group makes one of a program's processes
number 0 of one, or r of many. As all begin alike, draw the same random numbers and step by the same
gradients, their Gaussians stay the same without being sent.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
import torch.distributed as dist
from torch import Tensor


@dataclass(frozen=True)
class Ranks:
    """Which of how many processes this one is."""

    number: int = 0
    count: int = 1

    @classmethod
    def here(cls) -> "Ranks":
        """As the process group says, if the program has joined one."""
        if dist.is_available() and dist.is_initialized():
            return cls(dist.get_rank(), dist.get_world_size())
        return cls()

    def add_up(self, tensors: Iterable[Tensor]) -> None:
        """Make each the sum of all processes', in place; they have the same shapes everywhere."""
        if self.count > 1:
            works = [dist.all_reduce(each, async_op=True) for each in tensors]
            for work in works:
                assert work is not None
                work.wait()

    def meet(self) -> None:
        """Wait until all have come here."""
        if self.count > 1:
            dist.barrier()

    def largest(self, *numbers: float | int) -> list[float]:
        """The largest of each among all processes."""
        if self.count == 1:
            return [float(each) for each in numbers]
        device = "cuda" if dist.get_backend() == "nccl" else "cpu"
        all_of_them = torch.tensor(numbers, dtype=torch.float64, device=device)
        dist.all_reduce(all_of_them, dist.ReduceOp.MAX)
        return all_of_them.tolist()


ALONE = Ranks()
