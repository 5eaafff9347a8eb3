"""Processes that `torchrun` started, which train together; see `training.ranks`."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta

from stylesplat.errors import StyleSplatError

PATIENCE = timedelta(days=7)  # torchrun ends the others when one fails


@contextmanager
def joined(device: str) -> Iterator[bool]:
    """Join them, each with its share of the cores or a GPU of its own.

    Args:
        device: `auto`, `cpu` or `cuda`.

    Yields:
        Whether this process is the one that speaks, and keeps the result; by itself it is.

    Raises:
        StyleSplatError: If there are fewer GPUs than processes.
    """
    if "TORCHELASTIC_RUN_ID" not in os.environ or os.environ.get("WORLD_SIZE", "1") == "1":
        yield True
        return
    import torch.distributed as dist

    dist.init_process_group(_backend(device), timeout=PATIENCE)
    try:
        yield dist.get_rank() == 0
    finally:
        dist.destroy_process_group()


def _backend(device: str) -> str:
    """By which processes talk; takes what this one computes with."""
    import numba
    import torch

    from stylesplat.rendering.device import pick_device

    number, count = int(os.environ["LOCAL_RANK"]), int(os.environ["LOCAL_WORLD_SIZE"])
    if pick_device(device).type == "cuda":
        gpus = torch.cuda.device_count()
        if count > gpus:
            raise StyleSplatError(
                f"There are {count} processes for {gpus} GPUs. Give torchrun "
                f"`--nproc-per-node {gpus}`, or train with `--device cpu`."
            )
        torch.cuda.set_device(number)
        return "nccl"
    share = max(1, numba.get_num_threads() // count)
    numba.set_num_threads(share)
    torch.set_num_threads(share)
    return "gloo"
