"""Set-up of the whole suite."""

import stylesplat  # noqa: F401  (first: it sets up threading before torch loads)

import pytest  # isort: skip
import torch  # isort: skip


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("cuda") and not torch.cuda.is_available():
        pytest.skip("needs an NVIDIA GPU, and torch sees none")
