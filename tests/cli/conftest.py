import shutil
from pathlib import Path

import pytest
import torch
from PIL import Image

from balls import painting_quickly, save_scene
from capture_files import write_ball_capture
from processes import QUICK, run


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The balls as photos with label maps, in nerfstudio layout."""
    return write_ball_capture(tmp_path_factory.mktemp("capture"))


def save_stripes(path: Path) -> Path:
    rows = torch.arange(96) // 6 % 2
    pixels = torch.stack([200 * rows, 90 + 0 * rows, 255 - 200 * rows], dim=-1).to(torch.uint8)
    Image.fromarray(pixels[:, None].expand(96, 96, 3).numpy()).save(path)
    return path


@pytest.fixture
def style(tmp_path: Path) -> Path:
    """Stripes to paint with."""
    return save_stripes(tmp_path / "stripes.png")


@pytest.fixture(scope="session")
def styled_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("styled")
    scene, style, out = save_scene(folder / "scene"), save_stripes(folder / "a.png"), folder / "out"
    styles = ("--style", f"3={style}", "--style", f"7={style}", "--intensity", 0.5)
    with painting_quickly():
        assert run("stylize", scene, "-o", out, "--steps", 2, *QUICK, *styles) == 0
    return out


@pytest.fixture
def styled(scene: Path, styled_once: Path) -> Path:
    """Two balls in stripes, at half intensity, beside the scene."""
    return shutil.copytree(styled_once, scene.with_name("styled"))
