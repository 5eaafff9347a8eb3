"""What changes outside the object: our localisation in 3D against the loss masked in 2D.

    .venv/bin/python benchmarks/leakage.py

The baseline does as S2RF and StylizedGS do: the style loss counts where the raw label maps of the
capture show the object, and the colours of all Gaussians are trained. Same views, size, steps,
rate and style; nothing is split on either side. Measured in the held-out views, outside the
object's rendered coverage. Fox and desk, Starry Night, VGG19.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
import tyro
from bench import DATA, STYLES, machine, style_network, table, trained_scene
from torch import Tensor
from torch.nn import functional as F
from tqdm import tqdm

import stylesplat as ss
from stylesplat.evaluation.changes import measure_changes
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.selection.pick import pick
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.matching import nnfm_loss
from stylesplat.stylization.optimize import FINAL_RATE
from stylesplat.stylization.paint import paint_context, paint_objects
from stylesplat.stylization.style_image import read_style, style_features
from stylesplat.stylization.target import PaintTarget

SCENES = {"fox": (1.0, 100_000), "desk": (2.0, 80_000)}  # downscale and Gaussians
OBJECT_ID = 1
LENGTH = 320  # pixels of the longer side of the frames that the baseline is trained on


@dataclass(frozen=True)
class Options:
    """How long to train."""

    steps: int = 100
    """Steps of either side."""


LabelMaps = Sequence[Tensor | None]


def masked_in_2d(
    splats: Splats,
    views: tuple[Cameras, LabelMaps],
    style: Tensor,
    network: FeatureNetwork,
    steps: int,
) -> Splats:
    """Train the colours of all Gaussians on the style loss under the label maps."""
    config = StyleConfig()
    cameras, label_maps = views
    cameras = cameras.downscale(max(cameras.size) / LENGTH)
    target = style_features(style, network, (3,), length=config.scale * LENGTH)[0]
    sh0 = splats.sh0.clone().requires_grad_()
    optimizer = torch.optim.Adam([sh0], lr=config.lr, eps=1e-15)
    decay = torch.optim.lr_scheduler.ExponentialLR(optimizer, FINAL_RATE ** (1 / steps))
    generator = torch.Generator().manual_seed(0)
    for _ in tqdm(range(steps), desc="masked in 2D"):
        row = int(torch.randint(len(cameras), (1,), generator=generator))
        labels = label_maps[row]
        image = rasterize(replace(splats, sh0=sh0), cameras[row])[0][0]
        feats = network(image)[0]
        if labels is None:
            continue
        mask = (labels == OBJECT_ID)[None, None].float()
        cells = F.interpolate(mask, feats.shape[:2], mode="nearest")[0, 0] > 0
        if cells.any():
            optimizer.zero_grad()
            nnfm_loss(feats[cells], target).backward()
            optimizer.step()
            decay.step()
    return replace(splats, sh0=sh0.detach())


def compare(name: str, steps: int) -> list[list[object]]:
    """Both ways on one scene."""
    downscale, gaussians = SCENES[name]
    scene = ss.open(trained_scene(name, downscale=downscale, gaussians=gaussians))
    training, held_out = scene.working_views()
    assert held_out is not None
    loaded = ss.load(DATA / name, downscale=downscale)
    rows = [loaded.cameras.index(view) for view in training.names]
    assert loaded.label_maps is not None
    maps = [loaded.label_maps[row] for row in rows]
    network = style_network()
    style = read_style(STYLES / "van_gogh_starry_night_1024.jpg")
    picked = pick(scene.splats, object_id=OBJECT_ID)
    job = PaintTarget(name, picked, (style,), StyleConfig(steps=steps, quality="draft"))
    studio = paint_context(scene.splats, training, network, held_out=held_out)
    ours, _ = paint_objects(studio, [job])
    theirs = masked_in_2d(scene.splats, (training, maps), style, network, steps)
    return [
        _row(f"{name}, {how}", measure_changes(scene.splats, styled, held_out, picked))
        for how, styled in (("ours", ours.splats), ("masked in 2D", theirs))
    ]


def _row(name: str, found: dict[str, int | float]) -> list[object]:
    return [
        name,
        found["changed_gaussians"],
        f"{found['outside_psnr']:.1f}",
        f"{found['outside_max_difference']:.2g}",
        f"{found['edge_psnr']:.1f}",
        f"{found['rim_error']:.3f}",
    ]


def main(options: Options) -> None:
    """Print the table."""
    rows = [row for name in SCENES for row in compare(name, options.steps)]
    heads = ["scene", "changed Gaussians", "outside dB", "largest", "partly covered dB", "rim"]
    print(f"{machine()}, {options.steps} steps\n")
    print(table(heads, rows))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
