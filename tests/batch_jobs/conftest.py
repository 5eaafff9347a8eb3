from pathlib import Path

import pytest

from balls import CAMERAS, SPLATS
from capture_files import write_ball_capture
from stylesplat.io.scene_folder import save
from stylesplat.scene.scene import Scene


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """The balls as a scene."""
    folder = tmp_path / "scene"
    save(Scene(SPLATS, CAMERAS, held_out=CAMERAS.names[:1]), folder)
    return folder


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """The balls as photos."""
    return write_ball_capture(tmp_path / "capture")
