"""Set-up of the whole suite."""

import gc
import os
import random
import signal
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import type_checks  # noqa: F401  # isort: skip  (before what it checks)

# Sets up threading before torch loads, and registers what says that kernels are compiled
import stylesplat.rendering.kernels.jit  # noqa: F401  # isort: skip

import pytest  # isort: skip
import torch  # isort: skip

from filelock import FileLock
from numba import get_num_threads, set_num_threads
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from stylesplat.progress import Observer, observed
from tiny_models import network, stripes  # noqa: F401  (fixtures)

if TYPE_CHECKING:
    from browser import Browser


def pytest_configure() -> None:
    gc.disable()  # until all modules are loaded, in which it would look for garbage
    # Shells start background jobs with Ctrl-C ignored, which the processes that tests start would
    # inherit: they would not hear the Ctrl-C that they are sent
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """In the order that TEST_ORDER stands for, a number or a word.

    Folders are shuffled, files in their folders and tests in their files, so that what they share
    is made once. pytest-xdist needs the same order in all its workers.
    """
    if order := os.environ.get("TEST_ORDER"):
        drawn = random.Random(order)
        groups = {
            group: drawn.random() for item in items for group in (item.path.parent, item.path)
        }
        drawn.shuffle(items)
        items.sort(key=lambda item: (groups[item.path.parent], groups[item.path]))


def pytest_collection_finish() -> None:
    gc.freeze()  # nor later in what is loaded by now
    gc.enable()


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("cuda") and not torch.cuda.is_available():
        pytest.skip("needs an NVIDIA GPU, and torch sees none")


@pytest.fixture(scope="session", autouse=True)
def each_kernel_is_compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Workers of pytest-xdist wait for one that compiles a kernel, and find it in numba's cache.

    Nothing is said of it: it may be in any test.
    """
    compile, shared = Dispatcher.compile, tmp_path_factory.getbasetemp().parent

    def compile_alone(self: Dispatcher, signature: Any) -> Any:
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}.lock"
        # numba's own lock first, as for kernels that this one calls: threads wait in one order
        with global_compiler_lock, FileLock(shared / name, is_singleton=True):
            return compile(self, signature)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Dispatcher, "compile", compile_alone)
        patch.setattr(event, "_registered", defaultdict(list))
        yield


@pytest.fixture(scope="session", autouse=True)
def files_are_not_flushed() -> Iterator[None]:
    """It takes long, and only power cuts need it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        yield


CORES = get_num_threads()


def use_threads(count: int) -> None:
    set_num_threads(count)
    torch.set_num_threads(count)


@pytest.fixture(scope="session", autouse=True)
def workers_share_the_cores() -> None:
    """More threads than cores wait for each other, which takes about a tenth more."""
    use_threads(max(1, CORES // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))))


@pytest.fixture
def all_cores() -> Iterator[None]:
    """For what is to be the same by any number of threads."""
    before = get_num_threads()
    use_threads(CORES)
    yield
    use_threads(before)


@pytest.fixture
def said() -> Iterator[list[str]]:
    """What the library tells the user in the course of a test."""
    lines: list[str] = []

    class Listener(Observer):
        def say(self, line: str) -> None:
            lines.append(line)

    with observed(Listener()):
        yield lines


@pytest.fixture(scope="session")
def chromium() -> Iterator["Browser"]:
    """It takes seconds to start."""
    from browser import launched  # loads what types are checked of from later on

    with launched() as found:
        yield found


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
