"""The balls as photos on disk."""

from pathlib import Path

import torch
from PIL import Image

from balls import CAMERAS, SPLATS
from stylesplat.io.label_maps import write_label_map
from stylesplat.io.transforms import write_transforms
from stylesplat.rendering.rasterize import rasterize
from stylesplat.selection.labels import render_labels


def write_ball_capture(folder: Path) -> Path:
    """Write photos with label maps, in nerfstudio's layout, and return the folder."""
    (folder / "images").mkdir()
    for row, name in enumerate(CAMERAS.names):
        image = rasterize(SPLATS, CAMERAS[row])[0][0].clamp(0, 1)
        pixels = (255 * image).round().to(torch.uint8).numpy()
        Image.fromarray(pixels).save(folder / "images" / name, quality=95)
        labels = render_labels(SPLATS, CAMERAS[row])
        write_label_map(labels, folder / "object_mask" / f"{Path(name).stem}.png")
    write_transforms(CAMERAS, folder, points=SPLATS.means)
    return folder
