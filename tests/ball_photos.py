"""The balls as photos on disk."""

from dataclasses import replace
from pathlib import Path

import torch
from PIL import Image

from balls import CAMERAS, SPLATS
from stylesplat.io.captures.transforms import write_transforms
from stylesplat.io.label_maps import write_label_map
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.selection.identities import render_labels

ONLY_BALLS = SPLATS[torch.arange(len(SPLATS)) >= 200]  # the table comes first


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


def write_cut_outs(folder: Path, cameras: Cameras = CAMERAS) -> Path:
    """Write photos of the balls, without the table, before nothing: PNG files with alpha."""
    (folder / "images").mkdir(parents=True)
    names = tuple(f"{Path(name).stem}.png" for name in cameras.names)
    for row, name in enumerate(names):
        image, alphas, _ = rasterize(ONLY_BALLS, cameras[row])
        colors = image[0] / alphas[0].clamp(min=1e-6)  # PNG keeps colours apart from alpha
        pixels = torch.cat([colors, alphas[0]], dim=-1).clamp(0, 1)
        pixels = (255 * pixels).round().to(torch.uint8).numpy()
        Image.fromarray(pixels).save(folder / "images" / name)
    write_transforms(replace(cameras, names=names), folder, points=ONLY_BALLS.means)
    return folder
