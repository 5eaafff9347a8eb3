"""The balls as photos on disk."""

from pathlib import Path

import torch
from PIL import Image

from balls import CAMERAS, SPLATS
from stylesplat.io.captures.transforms import write_transforms
from stylesplat.io.label_maps import write_label_map
from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.selection.identities import render_labels


def write_ball_capture(folder: Path, cameras: Cameras = CAMERAS, *, masks: bool = True) -> Path:
    """Write photos, with label maps if wanted, in nerfstudio's layout, and return the folder."""
    (folder / "images").mkdir(parents=True)
    for row, name in enumerate(cameras.names):
        image = rasterize(SPLATS, cameras[row])[0][0].clamp(0, 1)
        pixels = (255 * image).round().to(torch.uint8).numpy()
        Image.fromarray(pixels).save(folder / "images" / name, quality=95)
        if masks:
            labels = render_labels(SPLATS, cameras[row])
            write_label_map(labels, folder / "object_mask" / f"{Path(name).stem}.png")
    write_transforms(cameras, folder, points=SPLATS.means)
    return folder
