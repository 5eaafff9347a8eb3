"""In which precision a machine convolves fastest: bfloat16 where there are instructions for it."""

from functools import cache

import torch
from llvmlite.binding import get_host_cpu_features

FAST_BFLOAT16 = ("amx-bf16", "avx512bf16")
"""Instructions with which VGG's convolutions are faster in bfloat16 than in float32.

A convolution of 128 channels on 48x48 pixels took, in float32 and in bfloat16 (one thread):

    AVX2                5.6 ms   24.1 ms
    AVX-512             2.6 ms    8.2 ms
    AVX-512 with BF16   2.5 ms    1.3 ms

and AMX was five times as fast as float32.
"""


@cache
def fastest_dtype(device: str) -> torch.dtype:
    """bfloat16 on processors that have instructions for it, else float32.

    It depends on the hardware alone, never on how busy that is.
    """
    if device != "cpu":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else torch.float32
    features = get_host_cpu_features()
    fast = any(features.get(name, False) for name in FAST_BFLOAT16)
    return torch.bfloat16 if fast else torch.float32
