from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from capture_files import write_capture


@pytest.fixture
def make_capture(tmp_path: Path) -> Callable[..., Path]:
    """Writes a COLMAP capture and returns its folder."""
    return partial(write_capture, tmp_path / "capture")
