"""`demo`: from photos to a repainted splat, on a still life that ships with us, and its report."""

import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import torch

from stylesplat.evaluation.summary import painted_gaussians, style_lines
from stylesplat.figures.html_page import Figure, Section, file_url, page_style, section_html
from stylesplat.figures.pictures import label_colors
from stylesplat.figures.sheets import object_sheet
from stylesplat.io.atomic import atomic_folder, refuse_occupied, write_file
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.images import write_image
from stylesplat.io.kinds import SCENE, TRANSFORMS
from stylesplat.io.label_maps import read_label_map
from stylesplat.io.renders import write_views
from stylesplat.io.scene_folder import open, save
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.stylization.config import STYLE_PRESETS, StyleConfig
from stylesplat.stylization.style import Style
from stylesplat.training.config import TRAIN_PRESETS, TrainConfig
from stylesplat.training.initialize import first_splats
from stylesplat.verbs.export import export
from stylesplat.verbs.render import render
from stylesplat.verbs.select import select
from stylesplat.verbs.stylize import stylize
from stylesplat.verbs.train import train

DEMO_TEMPLATE = Path(__file__).with_name("report.html")
REPORT = "report.html"
DEMO_SHEET = "objects.png"  # in the scene's folder
VIEW = "016"  # the held-out view in the report
CUT = 56  # percent of its width, where a line between vase and teapot hardly cuts either


def write_report(
    output: Path,
    capture: Path,
    scene: Scene,
    styled: Scene,
    *,
    paintings: Mapping[str, Path],
    seconds: float,
) -> None:
    """Write the report of a demo whose other results are in `output` already."""
    sections = _sections(output, capture, paintings, style_lines(styled.metrics, paintings))
    numbers = _numbers(scene.metrics, styled.metrics, paintings, seconds)
    page = Template(DEMO_TEMPLATE.read_text(encoding="utf-8")).substitute(
        style=page_style(),
        before=file_url(output / "before" / f"{VIEW}.png"),
        after=file_url(output / "after" / f"{VIEW}.png"),
        cut=CUT,
        sections="\n".join(map(section_html, sections)),
        numbers="\n".join(
            f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>"
            for name, value in numbers.items()
        ),
    )
    write_file(output / REPORT, page)


def _sections(
    output: Path, capture: Path, paintings: Mapping[str, Path], outcome: Sequence[str]
) -> list[Section]:
    maps = {}
    for folder in (capture / "object_mask", output / "labels"):
        maps[folder.name] = output / f"{folder.name}_colors.png"
        write_image(label_colors(read_label_map(folder / f"{VIEW}.png")), maps[folder.name])
    return [
        Section(
            "1. Photos with label maps",
            "48 photos of a ray-traced still life, and label maps with the mistakes that "
            "segmenters make: ragged borders, lost and merged objects.",
            (
                Figure(capture / "images" / f"{VIEW}.jpg", "one of the photos"),
                Figure(maps["object_mask"], "its label map, with mistakes"),
            ),
        ),
        Section(
            "2. Gaussians that know their object",
            "Training fits 3D Gaussians to the photos, each with 16 numbers that say what object "
            "it belongs to. All views together correct the mistakes of each.",
            (
                Figure(output / "before" / f"{VIEW}.png", "a view that was not trained on"),
                Figure(output / "identities" / f"{VIEW}.png", "the identities, as colours"),
                Figure(maps["labels"], "the label map that they give"),
            ),
        ),
        Section(
            "3. Objects to choose from",
            "stylesplat objects draws this sheet; stylesplat select gives an object a name.",
            (Figure(output / "scene" / DEMO_SHEET, DEMO_SHEET),),
        ),
        Section(
            "4. Two styles",
            "The vase and the teapot each take on a painting. Their Gaussians take on other "
            "colours, and small discs laid on them carry the strokes. "
            + " ".join(f"{line[:1].upper()}{line[1:]}" for line in outcome),
            tuple(Figure(path, f"for the {name}") for name, path in paintings.items()),
        ),
        Section(
            "5. The splat itself",
            "Drag to turn it; the handle in the middle lies between before and after. styled.ply "
            "opens in any viewer; styled.html holds the splat and this one, a single file to send.",
            (Figure(output / "styled.html", "styled.html"),),
        ),
        Section("6. All around", "A video of it.", (Figure(output / "orbit.mp4", "orbit.mp4"),)),
    ]


def _numbers(
    trained: Mapping[str, Any],
    styled: Mapping[str, Any],
    objects: Mapping[str, Path],
    seconds: float,
) -> dict[str, str]:
    rows = {
        "Gaussians": f"{trained['gaussians']:,}",
        "held-out PSNR": f"{trained['psnr']:.2f} dB",
        "held-out SSIM": f"{trained['ssim']:.3f}",
        "training": f"{trained['steps']:,} steps in {trained['seconds']:.0f} s",
        "stylisation": f"{styled['seconds']:.0f} s",
        "painted Gaussians": painted_gaussians(dict(styled), trained["gaussians"]),
        "the whole demo": f"{seconds:.0f} s",
    }
    for name in objects:
        before, after = styled["nnfm_before"][name], styled["nnfm_after"][name]
        rows[f"style distance (NNFM), {name}"] = f"{before:.3f} before, {after:.3f} after"
    return rows


ARCHIVE = Path(__file__).with_name("still_life.zip")  # made by scripts/still_life
# The capture has many points, so that few steps make it sharp.
TRAINING = replace(TRAIN_PRESETS["default"], steps=1250, sh_degree=2, max_gaussians=60_000)
STYLES = {"vase": "swirling_night", "teapot": "burning_tide"}  # object: painting
OBJECT_NAMES = {1: "vase", 2: "teapot"}
ENLARGEMENT = 2  # of the views before and after: the report shows them that wide
CAPTURE, SPLAT, PAGE, VIDEO = "capture", "styled.ply", "styled.html", "orbit.mp4"
STYLED, PAINTINGS_FOLDER = "styled", f"{CAPTURE}/styles"


def run_demo(
    output: Path,
    *,
    overwrite: bool = False,
    archive: Path = ARCHIVE,
    training: TrainConfig = TRAINING,
    styling: StyleConfig = STYLE_PRESETS["default"],
) -> dict[str, Any]:
    """Copy the still life, train, list the objects, repaint two, render, export, report.

    A run that was interrupted continues when it is started again. Returns the paths of what was
    made, and the seconds that it took.
    """
    unfinished = (output / CAPTURE).is_dir() and not (output / REPORT).exists()
    refuse_occupied(output, marker=REPORT, overwrite=overwrite or unfinished)
    start = time.monotonic()
    capture = copy_capture(output / CAPTURE, archive)
    scene = _train(capture, output / "scene", training, overwrite=overwrite)
    paintings = {name: output / PAINTINGS_FOLDER / f"{style}.jpg" for name, style in STYLES.items()}
    styled = stylize(scene, {name: Style(path, config=styling) for name, path in paintings.items()})
    save(styled, output / STYLED, overwrite=True)
    _render(scene, styled, output)
    for name in (SPLAT, PAGE):
        export(styled, output / name, overwrite=True)
    seconds = time.monotonic() - start
    write_report(output, capture, scene, styled, paintings=paintings, seconds=seconds)
    return {
        "report": output / REPORT,
        "splat": output / SPLAT,
        "page": output / PAGE,
        "video": output / VIDEO,
        "seconds": round(seconds),
    }


def copy_capture(folder: Path, archive: Path = ARCHIVE) -> Path:
    """Copy the still life into a folder, unless it is there: a capture with three paintings."""
    if not (folder / TRANSFORMS).is_file():
        with atomic_folder(folder, overwrite=True, marker=TRANSFORMS) as draft:
            zipfile.ZipFile(archive).extractall(draft)
    return folder


def _train(capture: Path, output: Path, config: TrainConfig, *, overwrite: bool) -> Scene:
    """The scene with its two objects, from disk if an earlier run has made it."""
    if (output / SCENE).exists() and not overwrite:
        return open(output)
    checkpoint = output.with_name("training.partial") / "checkpoint.pt"
    with warm_up_stylization(capture):
        scene = train(load(capture), config, checkpoint=checkpoint)
    for id, name in OBJECT_NAMES.items():
        scene = select(scene, name, id=id)
    save(scene, output, overwrite=True)
    sheet = object_sheet(scene.splats, scene.cameras, names=OBJECT_NAMES)
    write_image(sheet, output / DEMO_SHEET)
    shutil.rmtree(checkpoint.parent, ignore_errors=True)
    return open(output)  # with the paths that other commands find in the folder


def _render(scene: Scene, styled: Scene, output: Path) -> None:
    for source, what, folder, downscale in (
        (scene, "color", "before", 1 / ENLARGEMENT),
        (styled, "color", "after", 1 / ENLARGEMENT),
        (scene, "identities", "identities", 1.0),
        (scene, "labels", "labels", 1.0),
    ):
        views = render(source, "test", what=what, downscale=downscale)
        write_views(views.names, views.pictures, output / folder, overwrite=True)
    orbit = render(styled, "orbit")
    write_views(orbit.names, orbit.pictures, output / VIDEO, overwrite=True)


@contextmanager
def warm_up_stylization(capture: Path) -> Iterator[None]:
    """Compile the kernels of stylisation in another process, which ends with the block.

    Numba compiles on one core, and keeps machine code on disk for all processes.
    """
    command = [sys.executable, "-m", __name__, capture]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def stylize_noise(capture: Path, count: int = 400) -> None:
    """Paint and render some Gaussians as training begins with, which calls every kernel once."""
    photos = load(capture, downscale=5.0)
    splats = first_splats(
        photos,
        sh_degree=2,
        max_gaussians=count,
        generator=torch.Generator().manual_seed(0),
        ids=(0, 1),
    )
    splats = replace(splats, opacities=torch.full((count,), 2.0))
    noise = {"noise": SceneObject(torch.ones(count, dtype=torch.bool))}
    scene = Scene(splats, photos.cameras, held_out=photos.cameras.names[:1], objects=noise)
    style = Style(torch.rand(64, 64, 3), config=StyleConfig(steps=2, object_size=112))
    stylize(scene, {"noise": style}, device="cpu")
    next(render(scene, "test", what="identities").pictures)


if __name__ == "__main__":
    stylize_noise(Path(sys.argv[1]))
