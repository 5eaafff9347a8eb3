"""Which device is picked, and what is said of GPUs that are not used."""

import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.rendering import render as module
from stylesplat.rendering.render import pick_device


@pytest.fixture
def amd(monkeypatch: pytest.MonkeyPatch) -> None:
    """A build of torch for AMD's GPUs, which calls them `cuda`."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.version, "hip", "6.4")
    module._say_unused_gpu.cache_clear()


@pytest.mark.usefixtures("amd")
def test_on_a_gpu_of_amd_the_cpu_is_used_and_it_is_said_once(said: list[str]):
    assert {pick_device().type for _ in range(3)} == {"cpu"}
    assert said == ["Computing on the CPU: kernels are for NVIDIA's GPUs, not for AMD's."]
    with pytest.raises(StyleSplatError, match="torch sees no NVIDIA GPU here"):
        pick_device("cuda")


@pytest.mark.parametrize("name", ["gpu", "mps", "cuda:x", ""])
def test_what_is_no_device_is_refused(name: str):
    with pytest.raises(StyleSplatError, match="Use auto, cpu or cuda"):
        pick_device(name)
