import pytest
import torch

from rendering import emulated_cuda


@pytest.fixture(autouse=True)
def kernels_run_in_parallel(all_cores: None) -> None:
    """As for users."""


@pytest.fixture(autouse=True)
def kernels_are_emulated(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of CUDA, where there is no GPU."""
    if request.node.get_closest_marker("emulated") and not torch.cuda.is_available():
        emulated_cuda.install(monkeypatch)
