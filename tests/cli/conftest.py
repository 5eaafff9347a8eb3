from pathlib import Path

import pytest
import torch
from PIL import Image

from balls import CAMERAS, SPLATS
from stylesplat.io.label_maps import write_label_map
from stylesplat.io.scene_folder import Scene, write_scene
from stylesplat.io.transforms import write_transforms
from stylesplat.rendering.rasterize import rasterize
from stylesplat.selection.labels import render_labels


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The balls as photos with label maps, in nerfstudio layout."""
    folder = tmp_path_factory.mktemp("capture")
    (folder / "images").mkdir()
    for row, name in enumerate(CAMERAS.names):
        image = rasterize(SPLATS, CAMERAS[row])[0][0].clamp(0, 1)
        pixels = (255 * image).round().to(torch.uint8).numpy()
        Image.fromarray(pixels).save(folder / "images" / name, quality=95)
        labels = render_labels(SPLATS, CAMERAS[row])
        write_label_map(labels, folder / "object_mask" / f"{Path(name).stem}.png")
    write_transforms(CAMERAS, folder, points=SPLATS.means)
    return folder


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """The balls as a scene that is trained, with the first view held out."""
    info = {"test_views": [CAMERAS.names[0]], "settings": {"downscale": 1.0}}
    folder = tmp_path / "scene"
    write_scene(Scene(SPLATS, CAMERAS, info=info, metrics={"psnr": 30.0}), folder)
    return folder


@pytest.fixture
def style(tmp_path: Path) -> Path:
    """Stripes to paint with."""
    rows = torch.arange(96) // 6 % 2
    pixels = torch.stack([200 * rows, 90 + 0 * rows, 255 - 200 * rows], dim=-1).to(torch.uint8)
    path = tmp_path / "stripes.png"
    Image.fromarray(pixels[:, None].expand(96, 96, 3).numpy()).save(path)
    return path
