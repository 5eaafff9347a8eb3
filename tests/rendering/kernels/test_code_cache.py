"""Kernels run wherever their machine code can be kept, and where it cannot."""

import errno
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import pytest
from numba.core import event
from numba.core.caching import CompileResultCacheImpl, FunctionCache

import stylesplat
from stylesplat.rendering.kernels import code_cache
from stylesplat.rendering.kernels.code_cache import NOWHERE, TEMPORARY, private_folder
from stylesplat.rendering.kernels.compiling import ONCE
from stylesplat.rendering.kernels.jit import cached

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs POSIX's owners of files")
NOBODY = 65534


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The temporary folder of a test, as /tmp is; nothing has been said."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    folder.chmod(0o1777)
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setattr(code_cache, "said", set())
    return folder


@pytest.fixture(autouse=True)
def unannounced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other tests may have asked for a word when kernels compile."""
    monkeypatch.setattr(event, "_registered", defaultdict(list))


@pytest.fixture
def homeless(monkeypatch: pytest.MonkeyPatch) -> None:
    """numba finds none of its own places."""
    places = [code_cache.PrivateLocator]
    monkeypatch.setattr(code_cache._Places, "_locator_classes", places)


def plus_one(x: int) -> int:
    return x + 1


def test_numbas_places_come_first(said: list[str]):
    own = CompileResultCacheImpl._locator_classes
    assert code_cache._Places._locator_classes[:-1] == own
    cached()(plus_one)
    assert said == []


def test_else_the_temporary_folder(homeless: None, temporary: Path, said: list[str]):
    assert [cached()(plus_one)(1) for _ in range(2)] == [2, 2]
    folder = temporary / f"stylesplat-{os.getuid()}"
    assert said == [TEMPORARY.format(folder)]
    assert folder.stat().st_mode & 0o777 == 0o700
    kept = {*folder.rglob("*.nbc")}
    assert len(kept) == 1
    (index,) = folder.rglob("*.nbi")
    index.write_bytes(b"damaged")
    assert cached()(plus_one)(1) == 2, "what is damaged is made again"


def test_else_nowhere(homeless: None, temporary: Path, said: list[str]):
    (temporary / f"stylesplat-{os.getuid()}").symlink_to(temporary)
    assert [cached()(plus_one)(1) for _ in range(2)] == [2, 2]
    assert said == [NOWHERE]


def test_a_full_disk(said: list[str], monkeypatch: pytest.MonkeyPatch):
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(FunctionCache, "_save_overload", fail)
    monkeypatch.setattr(FunctionCache, "_load_overload", lambda *_: None)
    function = cached()(plus_one)
    assert (function(1), function(1.0)) == (2, 2.0)
    (line,) = said
    assert "No space left on device" in line


@pytest.mark.parametrize("kind", ["link", "file", "open", "another's"])
def test_a_folder_that_somebody_else_may_fill_is_refused(kind: str, temporary: Path):
    folder = temporary / f"stylesplat-{os.getuid()}"
    if kind == "link":
        (temporary / "elsewhere").mkdir(0o700)
        folder.symlink_to(temporary / "elsewhere")
    elif kind == "file":
        folder.touch(0o700)
    elif kind == "open":
        folder.mkdir()
        folder.chmod(0o770)
    elif os.getuid() == 0:
        folder.mkdir(0o700)
        os.chown(folder, NOBODY, NOBODY)
    else:
        pytest.skip("only root gives files away")
    with pytest.raises(PermissionError):
        private_folder()


def test_a_place_where_others_may_replace_it_is_refused(temporary: Path):
    assert private_folder() == private_folder() == temporary / f"stylesplat-{os.getuid()}"
    temporary.chmod(0o777)
    with pytest.raises(PermissionError):
        private_folder()


RUN = """
import os
import numba, numpy as np, scipy.spatial, torch
from stylesplat.cli.bars import Bars
from stylesplat.progress import listen
from stylesplat.scene.cameras import Cameras
listen(Bars())
numba.njit(lambda x: x + 1)(1)
os.setgroups([])
os.setgid(NOBODY)
os.setuid(NOBODY)  # Python itself may lie where only root can read
from stylesplat.rendering.kernels.tiles import depth_order
print(depth_order(np.ones(3, np.float32), np.ones((3, 2), np.int32)))
"""


@pytest.mark.skipif(os.name != "posix" or os.getuid() != 0, reason="only root becomes nobody")
def test_a_user_who_can_write_nowhere_else(temporary: Path):
    package = Path(stylesplat.__file__).parent
    for folder in [*temporary.parents][:4]:  # which pytest keeps to itself
        folder.chmod(folder.stat().st_mode | 0o111)
    done = subprocess.run(
        [sys.executable, "-c", RUN.replace("NOBODY", str(NOBODY))],
        env={"PYTHONPATH": str(package.parent), "TMPDIR": str(temporary), "HOME": "/nonexistent"},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (0, "[0 1 2]\n"), done.stderr
    place = temporary / f"stylesplat-{NOBODY}"
    assert done.stderr.splitlines() == [TEMPORARY.format(place), ONCE]


def test_other_options_are_other_code(homeless: None):
    hits = []
    for options in ({}, {"nogil": True}, {"nogil": True}):
        kernel = cached(**options)(plus_one)
        assert kernel(1) == 2
        hits.append(sum(kernel.stats.cache_hits.values()))
    assert hits == [0, 0, 1]
