"""Set-up of the whole suite."""

from collections.abc import Callable, Iterator
from pathlib import Path

import stylesplat  # noqa: F401  (first: it sets up threading before torch loads)

import pytest  # isort: skip
import torch  # isort: skip

from stylesplat.progress import Observer, observed
from tiny_models import network, stripes  # noqa: F401  (fixtures)


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("cuda") and not torch.cuda.is_available():
        pytest.skip("needs an NVIDIA GPU, and torch sees none")


@pytest.fixture
def said() -> Iterator[list[str]]:
    """What the library tells the user in the course of a test."""
    lines: list[str] = []

    class Listener(Observer):
        def say(self, line: str) -> None:
            lines.append(line)

    with observed(Listener()):
        yield lines


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """The folder of a trained scene."""
    from balls import save_scene  # loads what types are checked of from later on

    return save_scene(tmp_path / "scene")


@pytest.fixture(scope="module")
def quick_painting() -> Iterator[None]:
    from balls import painting_quickly  # loads torch's users: types are checked from later on

    with painting_quickly():
        yield


@pytest.fixture(scope="session")
def tiny_model(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder of a model with random weights, by kind; made once, so not to be changed."""
    root = tmp_path_factory.mktemp("models")

    def folder(kind: str) -> Path:
        if not (root / kind).exists():
            from tiny_models import write_model  # loads transformers: seconds

            write_model(kind, root / kind)
        return root / kind

    return folder
