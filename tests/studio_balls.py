"""A session with the balls, and quick styles."""

from pathlib import Path

import torch

from balls import CAMERAS, SPLATS
from stylesplat.io.scene_folder import open, save
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.session import Session
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.style import Style

QUICK = StyleConfig(steps=4, layers=(1,), object_size=30)


def session_in(folder: Path) -> Session:
    """The balls, saved and opened."""
    path = folder / "balls"
    save(Scene(SPLATS, CAMERAS), path)
    return Session(open(path), folder=path)


def stripes() -> torch.Tensor:
    rows = (torch.arange(64) // 6 % 2).float()
    return torch.stack([rows, 0.3 + 0 * rows, 1 - rows], dim=-1)[:, None].expand(64, 64, 3).clone()


def quick_style() -> Style:
    return Style(stripes(), config=QUICK)
