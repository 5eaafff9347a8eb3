"""Kernels are compiled once and cached by numba, or run uncached where it cannot write."""

import os
from collections import defaultdict
from pathlib import Path

import numba
import pytest
from numba.core import event
from numba.core.caching import CompileResultCacheImpl

from stylesplat.rendering.kernels import jit
from stylesplat.rendering.kernels.jit import (
    COMPILING,
    NO_CACHE,
    announce_compilation,
    cached,
    delete_stale_caches,
)


@pytest.fixture(autouse=True)
def unannounced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other tests may have registered a listener, or have had no cache."""
    monkeypatch.setattr(event, "_registered", defaultdict(list))
    jit.no_cache.cache_clear()


def plus_one(x: int) -> int:
    return x + 1


def test_compilation_is_announced_once(said: list[str]):
    announce_compilation.cache_clear()
    announce_compilation()
    announce_compilation()
    numba.njit(lambda x: x + 1)(1)
    numba.njit(lambda x: x + 2)(1)
    assert said == [COMPILING]


def test_code_is_loaded_from_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    hits = []
    for _ in range(2):
        kernel = cached()(plus_one)
        assert kernel(1) == 2
        hits.append(sum(kernel.stats.cache_hits.values()))
    assert hits == [0, 1]


def test_without_a_folder_kernels_run_all_the_same(said: list[str], monkeypatch):
    monkeypatch.setattr(CompileResultCacheImpl, "_locator_classes", [])
    assert [cached()(plus_one)(1) for _ in range(2)] == [2, 2]
    assert said == [NO_CACHE]


def test_caches_older_than_the_kernels_or_what_lies_beside_them_are_deleted(tmp_path: Path):
    folder = tmp_path / "package" / "__pycache__"
    folder.mkdir(parents=True)
    source = folder.parent / "inner.py"
    ages = {"a.f-1.py311.nbi": 0, "b.nbc": 2**32, "c.pyc": 0, "d.nbi": 2**31}  # 2**31: in 2038
    for path, age in ((source, 2**31 + 1), *((folder / name, age) for name, age in ages.items())):
        path.touch()
        os.utime(path, (age, age))
    delete_stale_caches(folder.parent)
    assert {path.name for path in folder.iterdir()} == {"b.nbc", "c.pyc"}
