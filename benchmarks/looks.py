"""Pictures to choose defaults by: three objects, four styles, the paper's preset and ours.

    .venv/bin/python benchmarks/looks.py --demo DEMO

One picture per scene in `benchmarks/out/looks`: a row per style, and the object before, after the
paper's preset and after the default one. Fox and desk are trained once; the demo's scene is the
`scene` folder that `stylesplat demo -o DEMO` makes, whose painting is the fourth style. The
paper's 500 steps at the photos' size take long on a CPU: `--paper-steps` shortens them.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import torch
import tyro
from bench import OUT, STYLES, style_network, trained_scene

import stylesplat as ss
from stylesplat.drawing.compositing import to_uint8
from stylesplat.io.images import write_image
from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import crop
from stylesplat.scene.splats import Splats
from stylesplat.selection.pick import pick
from stylesplat.stylization.object_views import Box, find_boxes
from stylesplat.stylization.paint_objects import paint
from stylesplat.stylization.style_config import PRESETS
from stylesplat.stylization.style_images import read_style

PAINTINGS = ("van_gogh_starry_night_1024", "kandinsky_composition_vii_1071")
PAINTINGS += ("hassam_south_ledges_1070",)
HEIGHT = 480  # pixels of a cell
MARGIN = 16  # pixels around the object


@dataclass(frozen=True)
class Options:
    """What to draw."""

    demo: Path | None = None
    """Folder that `stylesplat demo` made; without it its scene and painting are left out."""
    paper_steps: int = 40
    """Steps of the paper's preset."""


def cut_out(splats: Splats, camera: Cameras, box: Box) -> torch.Tensor:
    """The object in one view, [HEIGHT, _, 3]."""
    low = (box.low - MARGIN).clamp(min=0).int().tolist()
    high = torch.minimum(box.high + MARGIN, camera.sizes[0]).int().tolist()
    part = crop(camera, low, high)
    image = rasterize(splats, part.downscale(part.size[1] / HEIGHT))[0][0]
    return to_uint8(image)


def main(options: Options) -> None:
    """Draw the pictures."""
    scenes = {
        "fox": (trained_scene("fox", downscale=1, gaussians=100_000), 1),
        "desk": (trained_scene("desk", downscale=2, gaussians=80_000), 1),
    }
    paintings = [STYLES / f"{name}.jpg" for name in PAINTINGS]
    if options.demo is not None:
        scenes["demo"] = (options.demo / "scene", 1)
        paintings += options.demo.glob("capture/*/styles/swirling_night.png")
    network = style_network()
    paper = replace(PRESETS["paper"], steps=options.paper_steps)
    for name, (folder, object_id) in scenes.items():
        scene = ss.open(folder)
        training, held_out = scene.working_views()
        picked = pick(scene.splats, object_id=object_id)
        box = max(
            find_boxes(scene.splats, held_out or training, picked), key=lambda each: each.length
        )
        rows = []
        for painting in paintings:
            cells = [cut_out(scene.splats, box.camera, box)]
            for config in (paper, PRESETS["default"]):
                style = read_style(painting)
                styled = paint(
                    scene.splats, training, picked, style, config=config, network=network
                )
                cells.append(cut_out(styled, box.camera, box))
            rows.append(torch.cat(cells, dim=1))
        (OUT / "looks").mkdir(parents=True, exist_ok=True)
        write_image(torch.cat(rows), OUT / "looks" / f"{name}.png")
        print(OUT / "looks" / f"{name}.png", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
