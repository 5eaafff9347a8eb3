"""How good are the pictures? Objects and paintings against what could be had, on one page.

    .venv/bin/python benchmarks/looks.py --demo DEMO

The best that any 3D result could do in a held-out view is what its pixels become when they are
optimised with the same loss (`target_2d.py`). For each object and painting the table says, judged
by VGG19 (all style features, float32), NNFM at the photo's full, half and quarter size and how far
that is on the way from before to the best; how much detail there is, by octave, as a share of the
best's; how far the palette is from the painting's (sliced Wasserstein distance in Lab, and the
share of pixels farther than 10 from all its colours); how far views are from each other (RMSE of
neighbours, and of views farther apart); the band around the object, which should be 0. The
published method takes long: `--paper-steps 500` adds it. Fox and desk are trained once; the demo's
scene is the `scene` folder that `stylesplat demo -o DEMO` makes. The page, with pictures at full
size, is `benchmarks/out/looks/index.html`.
"""

import math
import time
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from statistics import mean
from typing import Literal

import cv2
import torch
import tyro
from bench import OUT, STYLES, machine, style_network, table, trained_scene
from octaves import octaves
from target_2d import Sight, canvas, target_2d
from torch import Tensor

import stylesplat as ss
from stylesplat.drawing.compositing import to_uint8
from stylesplat.evaluation.consistency import view_consistency
from stylesplat.evaluation.measure import changes, view_loss
from stylesplat.evaluation.palette import off_palette, palette_distance
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.shares import COVERED, coverage
from stylesplat.scene.sampling import evenly
from stylesplat.scene.splats import Splats
from stylesplat.selection.pick import pick
from stylesplat.stylization.looking import object_views
from stylesplat.stylization.matching import build_index
from stylesplat.stylization.near_palette import near_palette
from stylesplat.stylization.object_views import find_boxes, typical_length
from stylesplat.stylization.objective import Objective
from stylesplat.stylization.paint_objects import open_studio, paint
from stylesplat.stylization.repaint import target_features
from stylesplat.stylization.style_config import PRESETS
from stylesplat.stylization.style_images import read_style
from stylesplat.stylization.style_job import Studio, StyleJob

PAINTINGS = ("van_gogh_starry_night_1024", "kandinsky_composition_vii_1071")
PAINTINGS += ("hassam_south_ledges_1070",)
SIZES = {"full": 1.0, "half": 0.5, "quarter": 0.25}  # of the photo
HEAD = """<!doctype html><meta charset="utf-8"><title>Looks</title><style>
body{font:15px sans-serif;margin:2em;background:#222;color:#ddd} pre{font-size:14px}
.row{display:flex;gap:6px;overflow-x:auto} figure{margin:0} img{height:900px}</style>"""

Numbers = Mapping[str, Mapping[str, float]]
"""By what was done, what was measured."""


@dataclass(frozen=True)
class Options:
    """What to paint."""

    demo: Path | None = None
    """Folder that `stylesplat demo` made; without it its scene is left out."""
    scenes: tuple[Literal["fox", "desk", "demo"], ...] = ("fox", "desk", "demo")
    """Whose objects of label 1."""
    paintings: tuple[Path, ...] = tuple(STYLES / f"{name}.jpg" for name in PAINTINGS)
    """Pictures."""
    views: int = 2
    """Held-out views that are painted pixel by pixel."""
    target_steps: int = 150
    """Steps for their pixels."""
    own: bool = False
    """Paint on the object's own Gaussians, too, without a fresh canvas."""
    paper_steps: int = 0
    """Steps of the paper's preset, which has 500; 0 leaves it out."""


@dataclass(frozen=True)
class Case:
    """An object and a painting."""

    studio: Studio
    """The scene, its held-out views, and the judge's network."""
    job: StyleJob
    """The object and the painting, with the default settings."""
    length: float
    """Of the object in the photos."""
    sights: list[Sight]
    """The object in some of the views."""

    def palette(self) -> Tensor:
        """The painting's colours."""
        return self.job.styles[0].reshape(-1, 3)

    def targets(self, size: float) -> list[Tensor]:
        """The painting's features for an object that is smaller than in the photos."""
        return target_features(self.studio, self.job.config, self.job.styles, size * self.length)


def main(options: Options) -> None:
    """Paint, measure, write the page."""
    parts = [HEAD, f"<p>{escape(machine())}</p>"]
    for name, folder in scenes(options).items():
        for painting in options.paintings:
            start = time.perf_counter()
            pictures, numbers = compared(folder, painting, options)
            heads = ("", *next(iter(numbers.values())))
            rows = [(what, *map(digits, row.values())) for what, row in numbers.items()]
            title = f"{name}, {painting.stem}: {time.perf_counter() - start:.0f} s"
            print(f"\n{title}\n\n{table(heads, rows)}", flush=True)
            parts += [
                f"<h2>{escape(title)}</h2>",
                *map(figures, zip(*pictures.values(), strict=True)),
            ]
            parts.append(f"<p>{', '.join(pictures)}</p><pre>{escape(table(heads, rows))}</pre>")
            write_page(parts)


def scenes(options: Options) -> dict[str, Path]:
    """The folders of the scenes."""
    found = {}
    if "fox" in options.scenes:
        found["fox"] = trained_scene("fox", downscale=1, gaussians=100_000)
    if "desk" in options.scenes:
        found["desk"] = trained_scene("desk", downscale=2, gaussians=80_000)
    if "demo" in options.scenes and options.demo:
        found["demo"] = options.demo / "scene"
    return found


def compared(
    folder: Path, painting: Path, options: Options
) -> tuple[dict[str, list[Tensor]], Numbers]:
    """Pictures of what was done, one per view, and the numbers."""
    scene = ss.open(folder)
    training, held_out = scene.working_views()
    picked = pick(scene.splats, object_id=1)
    studio = open_studio(scene.splats, held_out or training, style_network())
    job = StyleJob(folder.name, picked, (read_style(painting),), PRESETS["default"])
    case = seen(studio, job, options.views)
    done = {"before": scene.splats}
    done["ours"] = paint(scene.splats, training, picked, job.styles[0], config=job.config)
    if options.own:
        own = replace(job.config, canvas="own")
        done["own"] = paint(scene.splats, training, picked, job.styles[0], config=own)
    if options.paper_steps:
        paper = replace(PRESETS["paper"], steps=options.paper_steps)
        done["paper"] = paint(
            scene.splats, training, picked, job.styles[0], config=paper, network=studio.network
        )
    pictures = {
        what: [rasterize(splats, s.camera)[0][0].clamp(0, 1) for s in case.sights]
        for what, splats in done.items()
    }
    pictures["best"] = best(case, options.target_steps)
    return pictures, measured(case, pictures, done)


def seen(studio: Studio, job: StyleJob, count: int) -> Case:
    """The object in some of the studio's views."""
    boxes = find_boxes(studio.splats, studio.cameras, job.picked)
    length = typical_length(boxes)
    views = evenly(object_views(studio, job, boxes, SIZES["full"]), count)
    sights = [
        Sight(
            view.camera,
            coverage(studio.splats, view.camera, job.picked).clamp(0, 1)[..., None],
            rasterize(studio.splats, view.camera)[0][0].clamp(0, 1),
        )
        for view in views
    ]
    return Case(studio, job, length, sights)


def best(case: Case, steps: int) -> list[Tensor]:
    """The views painted pixel by pixel."""
    studio, palette = case.studio, case.palette()
    rest = {"original": studio.splats, "config": case.job.config, "near": near_palette(palette)}
    network = studio.network.to(studio.splats.device, studio.precision)
    objectives = []
    for size in SIZES.values():
        styles = [build_index(each, studio.precision) for each in case.targets(size)]
        objectives.append((size, Objective(network=network, styles=styles, **rest)))
    return [target_2d(sight, palette, objectives, steps) for sight in case.sights]


def measured(
    case: Case, pictures: Mapping[str, list[Tensor]], done: Mapping[str, Splats]
) -> dict[str, dict[str, float]]:
    """The rows of the table."""
    studio, numbers = case.studio, {what: {} for what in pictures}
    masks = [sight.share[..., 0] > COVERED for sight in case.sights]
    layers = case.job.config.layers
    for size, share in SIZES.items():
        targets = case.targets(share)
        cells = [studio.network.cells(block) for block in layers]
        for what, images in pictures.items():
            canvases = [
                canvas(s, image, share, cells) for s, image in zip(case.sights, images, strict=True)
            ]
            with torch.no_grad():
                losses = [
                    view_loss(c.render(studio.splats), c, targets, studio.network, layers)
                    for c in canvases
                ]
            numbers[what][size] = mean(map(float, losses))
        before, there = (numbers[what][size] for what in ("before", "best"))
        for row in numbers.values():
            row[f"way {size}"] = (before - row[size]) / (before - there)
    detail = {what: details(images, masks) for what, images in pictures.items()}
    for what, images in pictures.items():
        pixels = torch.cat([i[mask] for i, mask in zip(images, masks, strict=True)])
        for octave, (have, wanted) in enumerate(zip(detail[what], detail["best"], strict=True)):
            numbers[what][f"{2**octave} px"] = have / wanted
        numbers[what]["palette"] = palette_distance(pixels, case.palette())
        numbers[what]["off %"] = 100 * off_palette(pixels, case.palette())
        numbers[what] |= in_space(case, done.get(what))
    return numbers


def details(images: list[Tensor], masks: list[Tensor]) -> list[float]:
    """What each octave adds, on average over views."""
    found = [octaves(image, mask) for image, mask in zip(images, masks, strict=True)]
    return [mean(each) for each in zip(*found, strict=True)]


def in_space(case: Case, splats: Splats | None) -> dict[str, float]:
    """Whether views agree, and what changed around; of a single picture that cannot be said."""
    names = {"short_range_rmse": "near", "long_range_rmse": "far", "rim_error": "rim"}
    if splats is None:
        return dict.fromkeys(names.values(), math.nan)
    base, views = case.studio.splats, case.studio.cameras
    found = view_consistency(base, splats, views, case.job.picked)
    found |= changes(base, splats, views[evenly(range(len(views)), 4)], case.job.picked)
    return {short: found.get(name, math.nan) for name, short in names.items()}


def digits(value: float) -> str:
    """What is not known is left empty."""
    return "" if math.isnan(value) else f"{value:.3g}"


def figures(images: tuple[Tensor, ...]) -> str:
    """Pictures of a view beside each other, their bytes within."""
    row = []
    for image in images:
        pixels = cv2.cvtColor(to_uint8(image).numpy(), cv2.COLOR_RGB2BGR)
        data = b64encode(cv2.imencode(".png", pixels)[1].tobytes()).decode()
        row.append(f'<figure><img src="data:image/png;base64,{data}"></figure>')
    return f'<div class="row">{"".join(row)}</div>'


def write_page(parts: list[str]) -> None:
    """Write what there is so far."""
    path = OUT / "looks" / "index.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(parts), encoding="utf-8")
    print(path, flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
