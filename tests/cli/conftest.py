from pathlib import Path

import pytest
import torch
from PIL import Image

from balls import CAMERAS, SPLATS
from capture_files import write_ball_capture
from processes import QUICK, run
from stylesplat.io.scene_folder import save
from stylesplat.scene.scene import Scene


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The balls as photos with label maps, in nerfstudio layout."""
    return write_ball_capture(tmp_path_factory.mktemp("capture"))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """The balls as a scene that is trained, with the first view held out."""
    folder = tmp_path / "scene"
    save(Scene(SPLATS, CAMERAS, held_out=CAMERAS.names[:1], metrics={"psnr": 30.0}), folder)
    return folder


@pytest.fixture
def style(tmp_path: Path) -> Path:
    """Stripes to paint with."""
    rows = torch.arange(96) // 6 % 2
    pixels = torch.stack([200 * rows, 90 + 0 * rows, 255 - 200 * rows], dim=-1).to(torch.uint8)
    path = tmp_path / "stripes.png"
    Image.fromarray(pixels[:, None].expand(96, 96, 3).numpy()).save(path)
    return path


@pytest.fixture
def styled(scene: Path, style: Path, quick_painting: None) -> Path:
    """Two balls in stripes, at half intensity."""
    out = scene.with_name("styled")
    styles = ("--style", f"3={style}", "--style", f"7={style}")
    assert run("stylize", scene, "-o", out, "--steps", 2, "--intensity", 0.5, *QUICK, *styles) == 0
    return out
