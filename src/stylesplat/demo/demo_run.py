"""`demo`: the whole way from photos to a repainted splat, on a scene made here."""

import shutil
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from stylesplat.demo.demo_capture import demo_capture
from stylesplat.demo.rehearsal import compiled_meanwhile
from stylesplat.demo.report import write_report
from stylesplat.evaluation.in_words import painted_gaussians, style_lines
from stylesplat.figures.object_sheet import object_sheet
from stylesplat.figures.page_parts import Figure, Section
from stylesplat.figures.pictures import label_colors
from stylesplat.figures.quiet_cut import quiet_cut
from stylesplat.io.captures.capture_folder import exact_masks
from stylesplat.io.folders import refuse_occupied
from stylesplat.io.images import write_image
from stylesplat.io.label_maps import read_label_map
from stylesplat.io.scene_folder import SCENE, open, save
from stylesplat.io.view_files import write_views
from stylesplat.scene.scene import Scene
from stylesplat.stylization.config import PRESETS as STYLE_PRESETS
from stylesplat.stylization.style import Style
from stylesplat.training.train_config import PRESETS as TRAIN_PRESETS
from stylesplat.verbs.export import export
from stylesplat.verbs.load import load
from stylesplat.verbs.render import render
from stylesplat.verbs.select import select
from stylesplat.verbs.stylize import stylize
from stylesplat.verbs.train import train

# The capture has many points, so that few steps make it sharp.
TRAINING = replace(TRAIN_PRESETS["default"], steps=1250, sh_degree=2, max_gaussians=60_000)
STYLING = STYLE_PRESETS["default"]
STYLES = {"vase": "swirling_night", "teapot": "burning_tide"}  # object: painting
OBJECT_IDS = {"vase": 1, "teapot": 2}
SHOWN = "016"  # the view in the report: a line between its painted objects cuts neither
LARGER = 2  # times the photos' size: the report shows the view before and after as wide
REPORT = "report.html"
SPLAT, PAGE = "styled.ply", "styled.html"
CAPTURE = "capture"
SHEET = "objects.png"  # in the scene's folder


def run_demo(output: Path, *, overwrite: bool = False) -> dict[str, Any]:
    """Make the still life, train, list the objects, repaint two, render, export, report.

    A run that was interrupted continues when it is started again.

    Returns:
        The paths of what was made, and the seconds that it took.

    Raises:
        StyleSplatError: If `output` holds something else or cannot be written.
    """
    unfinished = (output / CAPTURE).is_dir() and not (output / REPORT).exists()
    refuse_occupied(output, marker=REPORT, overwrite=overwrite or unfinished)
    start = time.monotonic()
    capture = _capture(output / CAPTURE)
    scene = _trained(capture, output / "scene", overwrite=overwrite)
    styled = stylize(
        scene,
        {
            name: Style(capture / "styles" / f"{style}.png", config=STYLING)
            for name, style in STYLES.items()
        },
        capture=load(capture, masks=exact_masks(capture)),
    )
    save(styled, output / "styled", overwrite=True)
    _render(scene, styled, output)
    for name in (SPLAT, PAGE):
        export(styled, output / name, overwrite=True)
    seconds = time.monotonic() - start
    _report(output, capture, scene, styled, seconds)
    return {
        "report": output / REPORT,
        "splat": output / SPLAT,
        "page": output / PAGE,
        "video": output / "orbit.mp4",
        "seconds": round(seconds),
    }


def _capture(folder: Path) -> Path:
    """The photos; while they are made for the first time, kernels are compiled."""
    made = folder.is_dir()
    with nullcontext() if made else compiled_meanwhile("train"):
        return demo_capture(folder)


def _trained(capture: Path, output: Path, *, overwrite: bool) -> Scene:
    """The scene with its two objects, from disk if an earlier run has made it."""
    checkpoint = output.with_name("training.partial") / "checkpoint.pt"
    if (output / SCENE).exists() and not overwrite:
        return open(output)
    with compiled_meanwhile("stylize"):
        scene = train(load(capture), TRAINING, checkpoint=checkpoint)
    for name, id in OBJECT_IDS.items():
        scene = select(scene, name, id=id)
    save(scene, output, overwrite=True)
    names = {id: name for name, id in OBJECT_IDS.items()}
    write_image(object_sheet(scene.splats, scene.cameras, names=names), output / SHEET)
    shutil.rmtree(checkpoint.parent, ignore_errors=True)
    return open(output)  # as whoever goes on from the folder has it


def _render(scene: Scene, styled: Scene, output: Path) -> None:
    for source, what, folder, downscale in (
        (scene, "color", "before", 1 / LARGER),
        (styled, "color", "after", 1 / LARGER),
        (scene, "identities", "identities", 1.0),
        (scene, "labels", "labels", 1.0),
    ):
        views = render(source, "test", what=what, downscale=downscale)
        write_views(views.names, views.pictures, output / folder, overwrite=True)
    orbit = render(styled, "orbit")
    write_views(orbit.names, orbit.pictures, output / "orbit.mp4", overwrite=True)


def _report(
    output: Path,
    capture: Path,
    scene: Scene,
    styled: Scene,
    seconds: float,
) -> None:
    name = f"{SHOWN}.png"
    camera = scene.cameras[scene.cameras.index(name)]
    write_report(
        output / REPORT,
        before=output / "before" / name,
        after=output / "after" / name,
        cut=quiet_cut(scene.splats, camera, [scene.objects[each].picked for each in STYLES]),
        sections=(
            *_training_story(output, capture),
            *_styling_story(capture, style_lines(styled.metrics, STYLES), output / "scene" / SHEET),
            *_results(output),
        ),
        numbers=_numbers(dict(scene.metrics), dict(styled.metrics), seconds),
    )


def _training_story(output: Path, capture: Path) -> tuple[Section, ...]:
    name = f"{SHOWN}.png"
    masks = {}
    for folder in (capture / "object_mask", output / "labels"):
        masks[folder.name] = output / f"{folder.name}_colors.png"
        write_image(label_colors(read_label_map(folder / name)), masks[folder.name])
    photos = Section(
        "1. Photos with label maps",
        "48 photos of a still life, ray-traced by the package itself, and label maps with the "
        "mistakes that segmenters make: ragged borders, lost and merged objects.",
        (
            Figure(capture / "images" / name, "one of the photos"),
            Figure(masks["object_mask"], "its label map, with mistakes"),
        ),
    )
    gaussians = Section(
        "2. Gaussians that know their object",
        "Training fits 3D Gaussians to the photos, each with 16 numbers that say what object it "
        "belongs to. All views together correct the mistakes of each.",
        (
            Figure(output / "before" / name, "a view that was not trained on"),
            Figure(output / "identities" / name, "the identities, as colours"),
            Figure(masks["labels"], "the label map that they give"),
        ),
    )
    return photos, gaussians


def _styling_story(capture: Path, outcome: Sequence[str], sheet: Path) -> tuple[Section, ...]:
    paintings = tuple(
        Figure(capture / "styles" / f"{style}.png", f"for the {name}")
        for name, style in STYLES.items()
    )
    return (
        Section(
            "3. Objects to choose from",
            "stylesplat objects draws this sheet; stylesplat select gives an object a name.",
            (Figure(sheet, SHEET),),
        ),
        Section(
            "4. Two styles",
            "The vase and the teapot each take on a painting, made by the package too. Their "
            "Gaussians take on other colours, and small discs laid on them carry the strokes. "
            + " ".join(f"{line[:1].upper()}{line[1:]}" for line in outcome),
            paintings,
        ),
    )


def _results(output: Path) -> tuple[Section, ...]:
    return (
        Section(
            "5. The splat itself",
            f"Drag to turn it; the handle in the middle lies between before and after. {SPLAT} "
            f"opens in any viewer; {PAGE} holds the splat and this one, a single file to send.",
            (Figure(output / PAGE, PAGE),),
        ),
        Section("6. All around", "A video of it.", (Figure(output / "orbit.mp4", "orbit.mp4"),)),
    )


def _numbers(trained: dict[str, Any], styled: dict[str, Any], seconds: float) -> dict[str, str]:
    rows = {
        "Gaussians": f"{trained['gaussians']:,}",
        "held-out PSNR": f"{trained['psnr']:.2f} dB",
        "held-out SSIM": f"{trained['ssim']:.3f}",
        "training": f"{trained['steps']:,} steps in {trained['seconds']:.0f} s",
        "stylisation": f"{styled['seconds']:.0f} s",
        "painted Gaussians": painted_gaussians(styled, trained["gaussians"]),
        "the whole demo": f"{seconds:.0f} s",
    }
    for name in STYLES:
        before, after = styled["nnfm_before"][name], styled["nnfm_after"][name]
        rows[f"style distance (NNFM), {name}"] = f"{before:.3f} before, {after:.3f} after"
    return rows
