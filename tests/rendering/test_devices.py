"""Which device is picked, and what is said of GPUs that are not used."""

import re
import warnings
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.rendering import nvrtc
from stylesplat.rendering import render as module
from stylesplat.rendering.nvrtc import DriverState
from stylesplat.rendering.render import pick_device

A_GPU = DriverState((12, 4), gpus=1)


@pytest.fixture(autouse=True)
def nothing_said_yet() -> None:
    module._say_why_gpu_is_unused.cache_clear()


@pytest.fixture
def amd(monkeypatch: pytest.MonkeyPatch) -> None:
    """A build of torch for AMD's GPUs, which calls them `cuda`."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.version, "hip", "6.4")


@pytest.mark.usefixtures("amd")
def test_on_a_gpu_of_amd_the_cpu_is_used_and_it_is_said_once(said: list[str]):
    assert {pick_device().type for _ in range(3)} == {"cpu"}
    assert said == ["Computing on the CPU: kernels are for NVIDIA's GPUs, not for AMD's."]
    with pytest.raises(StyleSplatError, match="not for AMD's"):
        pick_device("cuda")


def test_on_a_gpu_of_apple_the_cpu_is_used_and_it_is_said(
    monkeypatch: pytest.MonkeyPatch, said: list[str]
):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: True)
    assert pick_device().type == "cpu"
    assert said == ["Computing on the CPU: kernels are for NVIDIA's GPUs, not for Apple's."]


@pytest.mark.parametrize(
    ("driver", "built_for", "fact"),
    [
        (A_GPU, None, "built without CUDA. Install a CUDA build"),
        (A_GPU, "13.2", "too old: it supports CUDA 12.4, and torch .* needs 13.2. Update"),
        (A_GPU, "12.8", "Restart the machine"),
        (DriverState((12, 4), gpus=0), "13.2", None),
        (None, "13.2", None),
    ],
    ids=["no CUDA in torch", "old driver", "broken driver", "no GPU", "no driver"],
)
def test_why_a_gpu_is_unused_is_one_line_that_is_true_here(
    monkeypatch: pytest.MonkeyPatch,
    said: list[str],
    driver: DriverState | None,
    built_for: str | None,
    fact: str | None,
):
    """Torch's own warning, of many lines, is not shown."""

    def is_available() -> bool:
        warnings.warn(
            "CUDA initialization: The NVIDIA driver on your system is too old", stacklevel=2
        )
        return False

    monkeypatch.setattr(torch.cuda, "is_available", is_available)
    monkeypatch.setattr(torch.version, "cuda", built_for)
    monkeypatch.setattr(module, "driver_state", lambda: driver)
    assert {pick_device().type for _ in range(2)} == {"cpu"}
    assert len(said) == (fact is not None)
    assert fact is None or re.search(fact, said[0])
    with pytest.raises(StyleSplatError, match=fact or "torch sees no NVIDIA GPU here"):
        pick_device("cuda")


@pytest.mark.parametrize(("result", "gpus"), [(0, 2), (100, 0)], ids=["GPUs", "none"])
def test_the_driver_says_what_it_supports(monkeypatch: pytest.MonkeyPatch, result: int, gpus: int):
    def answer(value: int) -> Callable[..., int]:
        def fill(pointer: Any) -> int:
            pointer._obj.value = value
            return 0

        return fill

    library = SimpleNamespace(
        cuDriverGetVersion=answer(12040), cuDeviceGetCount=answer(2), cuInit=lambda _: result
    )
    monkeypatch.setattr(nvrtc, "_driver", lambda: library)
    assert nvrtc.driver_state() == DriverState((12, 4), gpus)


def test_without_a_driver_nothing_is_asked(monkeypatch: pytest.MonkeyPatch):
    def missing() -> None:
        raise OSError("libcuda.so.1: cannot open shared object file")

    monkeypatch.setattr(nvrtc, "_driver", missing)
    assert nvrtc.driver_state() is None


@pytest.mark.parametrize("name", ["gpu", "mps", "cuda:x", ""])
def test_what_is_no_device_is_refused(name: str):
    with pytest.raises(StyleSplatError, match="Use auto, cpu or cuda"):
        pick_device(name)
