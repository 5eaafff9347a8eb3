from pathlib import Path

import pytest
import torch

from stylesplat.stylization.features.network import fastest_dtype

CPUINFO = Path("/proc/cpuinfo")


@pytest.mark.skipif(not CPUINFO.is_file(), reason="only Linux lists what a processor can do there")
def test_the_choice_is_what_the_processor_can_do():
    flags = CPUINFO.read_text().split()
    fast = "amx_bf16" in flags or "avx512_bf16" in flags
    assert fastest_dtype("cpu") == (torch.bfloat16 if fast else torch.float32)
