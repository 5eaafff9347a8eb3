"""What of the paint lands beside an object, and what of the object it misses.

    .venv/bin/python benchmarks/spill.py --demo DEMO [--fox SCENE]

On the demo (the folder that `stylesplat demo -o DEMO` makes) against its exact label maps, vase
and teapot, in all held-out and some training views; on the fox against outlines that were drawn by
hand into four of its photos, each pick painted hard and soft with the same settings. Spill: pixels
farther outside the object than a reach (2 and 6 pixels) that changed by more than 0.05 in a
channel, as a share of its area. Missed: pixels as far inside that changed by at most 0.02 in all
channels, as a share of these. Rim: by how much the PSNR with the photo falls between the reach and
6 pixels outside (the demo), and from the object's edge to 6 pixels, where pixels at the edge are
partly the object's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import mean

import tyro
from bench import DATA, STYLES, machine, table, trained_scene
from fox_outlines import FOX, outline_mask
from judge import distances, spill_and_missed
from torch import Tensor

import stylesplat as ss
from stylesplat.metrics.psnr import decibels
from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import find_object
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features.weights import load_weights
from stylesplat.stylization.paint import paint_context, paint_objects
from stylesplat.stylization.style_image import read_style
from stylesplat.stylization.target import PaintTarget

RIM = 6.0  # pixels
DEMO_REACH, FOX_REACH = 2.0, 6.0  # pixels: exact label maps, outlines by hand
SOME = 6  # training views of the demo


@dataclass(frozen=True)
class Options:
    """What to measure."""

    demo: Path | None = None
    """Folder that `stylesplat demo` made; without it the demo is left out."""
    fox: Path | None = None
    """Trained scene of the fox; by default one is trained and kept."""
    steps: int = 300
    """Optimiser steps per object."""
    growth: float = 4.0
    """How many times as many Gaussians an object may get."""


@dataclass(frozen=True)
class View:
    """Where the painted objects are in one photo."""

    camera: Cameras
    """The photo's."""
    inside: Tensor
    """Their pixels."""
    photo: Tensor | None = None
    """Its colours."""


def measure(before: Tensor, after: Tensor, view: View, reach: float) -> list[float]:
    """Spill, missed, and how many decibels the two rims lose."""
    found = [*spill_and_missed(before, after, view.inside, reach)]
    outside = distances(~view.inside)
    if view.photo is None:
        return found
    for low in (reach, 0.0):
        rim = (outside > low) & (outside <= RIM)
        pair = (decibels((image - view.photo)[rim].square().mean()) for image in (before, after))
        found.append(float(next(pair) - next(pair)))
    return found


def painted(scene: Scene, names: Sequence[str], style: Path, config: StyleConfig) -> ss.Splats:
    """The scene's Gaussians with some objects painted."""
    training, held_out = scene.working_views()
    picture, network = read_style(style), load_weights("compact", depth=3)
    jobs = [PaintTarget(name, find_object(scene, name), (picture,), config) for name in names]
    studio = paint_context(scene.splats, training, network, held_out=held_out)
    return paint_objects(studio, jobs)[0].splats


def rows(
    name: str, scene: Scene, pair: Sequence[ss.Splats], views: Sequence[View], reach: float
) -> list[list[object]]:
    """Each way of painting one scene: mean and worst of all views."""
    found = []
    for way, splats in zip(("hard", "soft"), pair, strict=True):
        numbers = []
        for view in views:
            before, after = (
                rasterize(s, view.camera)[0][0].clamp(0, 1) for s in (scene.splats, splats)
            )
            numbers.append(measure(before, after, view, reach))
        columns = list(zip(*numbers, strict=True))
        shares = [f"{100 * mean(c):.2f} ({100 * max(c):.2f})" for c in columns[:2]]
        rims = [f"{mean(c):.2f} ({max(c):.2f})" for c in columns[2:]] or ["", ""]
        found.append([f"{name}, {way}", *shares, *rims])
    return found


def demo_views(folder: Path, scene: Scene) -> list[View]:
    """All held-out views of the demo and some others."""
    training, held_out = scene.working_views()
    assert held_out is not None
    some = training[list(range(0, len(training), len(training) // SOME))]
    loaded = ss.load(folder, masks=folder / "object_mask_exact")
    assert loaded.label_maps is not None
    views = []
    for camera in (*_each(held_out), *_each(some)):
        row = loaded.cameras.index(camera.names[0])
        labels = loaded.label_maps[row]
        assert labels is not None
        inside = (labels == 1) | (labels == 2)
        views.append(View(camera, inside, loaded.photos[row].float() / 255))
    return views


def fox_views(scene: Scene) -> list[View]:
    """The photos with outlines."""
    training, held_out = scene.working_views()
    every = training if held_out is None else training + held_out
    views = []
    for name in FOX:
        camera = every[every.index(name)]
        views.append(View(camera, outline_mask(name, camera.size)))
    return views


def _each(cameras: Cameras) -> list[Cameras]:
    return [cameras[row] for row in range(len(cameras))]


def main(options: Options) -> None:
    """Print the table."""
    soft = StyleConfig(steps=options.steps, max_growth=options.growth)
    ways = (replace(soft, hard=True), soft)
    found = []
    if options.demo is not None:
        (folder,) = (options.demo / "capture").iterdir()
        scene = ss.open(options.demo / "scene")
        style = folder / "styles" / "swirling_night.png"
        pair = [painted(scene, ("vase", "teapot"), style, way) for way in ways]
        found += rows("demo", scene, pair, demo_views(folder, scene), DEMO_REACH)
    if options.fox is not None or DATA.is_dir():
        path = options.fox or trained_scene("fox", downscale=1, gaussians=100_000)
        scene = ss.open(path)
        style = STYLES / "van_gogh_starry_night_1024.jpg"
        pair = [painted(scene, ("1",), style, way) for way in ways]
        found += rows("fox", scene, pair, fox_views(scene), FOX_REACH)
    heads = ["scene", "spill %", "missed %", "rim dB", "rim with the edge dB"]
    print(f"{machine()}, {options.steps} steps; means, and in brackets the worst view\n")
    print(table(heads, found))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
