"""Whether this processor convolves faster in bfloat16."""

import time
from functools import cache

import torch
from torch.nn import functional as F

CHANNELS, SIZE = 128, 48  # of the convolution that is timed, one of VGG's
REPEATS = 8  # the fastest counts: other processes only slow
WORTHWHILE = 1.3  # times faster; processors that know the format reach 2 and more, others lose


@cache
def fastest_dtype(device: str) -> torch.dtype:
    """bfloat16 on processors with instructions for it, else float32: a self-test of 0.1 s."""
    if device != "cpu":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else torch.float32
    dtypes = torch.float32, torch.bfloat16
    seconds = [[_convolution_seconds(dtype) for dtype in dtypes] for _ in range(REPEATS)]
    slow, fast = (min(times) for times in zip(*seconds[1:], strict=True))  # the first warm up
    return torch.bfloat16 if slow > WORTHWHILE * fast else torch.float32


@torch.no_grad()
def _convolution_seconds(dtype: torch.dtype) -> float:
    image = torch.zeros(1, CHANNELS, SIZE, SIZE, dtype=dtype)
    weight = torch.zeros(CHANNELS, CHANNELS, 3, 3, dtype=dtype)
    image, weight = (t.contiguous(memory_format=torch.channels_last) for t in (image, weight))
    start = time.process_time()  # of all threads: waiting for other processes does not count
    F.conv2d(image, weight, padding=1)
    return time.process_time() - start
