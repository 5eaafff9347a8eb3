from collections.abc import Callable
from pathlib import Path

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.colmap import read_figures


def test_none_without_a_model_or_tracks(make_capture: Callable[..., Path], tmp_path: Path):
    assert read_figures(tmp_path / "nowhere") is None
    assert read_figures(make_capture()) is None


def test_a_damaged_model(make_capture: Callable[..., Path]):
    folder = make_capture()
    file = folder / "sparse" / "0" / "points3D.bin"
    file.write_bytes(file.read_bytes()[:-3])
    with pytest.raises(StyleSplatError, match="truncated"):
        read_figures(folder)
