"""`demo`: the whole way from photos to a repainted splat, on a scene made here."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from stylesplat.demo.demo_capture import demo_capture
from stylesplat.demo.report import Figure, Section, write_report
from stylesplat.drawing.pictures import label_colors
from stylesplat.verbs.export import export
from stylesplat.io.files import refuse_occupied
from stylesplat.io.images import write_image
from stylesplat.io.label_maps import read_label_map
from stylesplat.io.scene_folder import SCENE, read_scene
from stylesplat.stylization.style_config import PRESETS as STYLE_PRESETS
from stylesplat.training.train_config import PRESETS as TRAIN_PRESETS
from stylesplat.verbs.objects import list_objects
from stylesplat.verbs.recipe import StyledObject
from stylesplat.verbs.render import render_scene
from stylesplat.verbs.select import Choice, select_object
from stylesplat.verbs.stylize import stylize_scene
from stylesplat.verbs.train import train_scene

# Under five minutes in all on two cores; many small Gaussians on the objects carry the strokes.
TRAINING = replace(
    TRAIN_PRESETS["default"],
    steps=1800,
    max_gaussians=60_000,
    object_growth=10.0,
    object_pixels=2.5,
)
STYLING = STYLE_PRESETS["default"]
STYLES = {"vase": "swirling_night", "teapot": "burning_tide"}  # object: painting
OBJECT_IDS = {"vase": 1, "teapot": 2}
SHOWN = "000"  # the view in the report
REPORT = "report.html"
CAPTURE = "capture"


def run_demo(output: Path, *, overwrite: bool = False) -> dict[str, Any]:
    """Make the still life, train, list the objects, repaint two, render, export, report.

    A run that was interrupted continues when it is started again.

    Returns:
        The paths of what was made, and the seconds that it took.

    Raises:
        StyleSplatError: If `output` holds something else or cannot be written.
    """
    unfinished = (output / CAPTURE).is_dir() and not (output / REPORT).exists()
    if not (overwrite or unfinished):
        refuse_occupied(output, marker=REPORT)
    start = time.monotonic()
    capture, scene, styled = demo_capture(output / CAPTURE), output / "scene", output / "styled"
    if overwrite or not (scene / SCENE).exists():
        train_scene(capture, scene, config=TRAINING, overwrite=overwrite)
    trained = read_scene(scene).metrics
    list_objects(scene)
    for name, id in OBJECT_IDS.items():
        select_object(scene, name, Choice(ids=(id,)))
    measured = stylize_scene(
        scene,
        styled,
        [
            StyledObject(name, (capture / "styles" / f"{style}.png",), STYLING)
            for name, style in STYLES.items()
        ],
        overwrite=True,
    )
    _render(output)
    export(read_scene(styled).splats, output / "styled.ply")
    seconds = time.monotonic() - start
    _report(output, capture, trained, measured, seconds)
    return {
        "report": output / REPORT,
        "splat": output / "styled.ply",
        "video": output / "orbit.mp4",
        "seconds": round(seconds),
    }


def _render(output: Path) -> None:
    scene, styled = output / "scene", output / "styled"
    for source, what, folder in (
        (scene, "color", "before"),
        (styled, "color", "after"),
        (scene, "identities", "identities"),
        (scene, "labels", "labels"),
    ):
        render_scene(source, output / folder, views="test", what=what, overwrite=True)
    render_scene(styled, output / "orbit.mp4", views="orbit", overwrite=True)


def _report(
    output: Path,
    capture: Path,
    trained: dict[str, Any],
    styled: dict[str, Any],
    seconds: float,
) -> None:
    name = f"{SHOWN}.png"
    write_report(
        output / REPORT,
        before=output / "before" / name,
        after=output / "after" / name,
        sections=(*_training_story(output, capture), *_styling_story(output, capture)),
        numbers=_numbers(trained, styled, seconds),
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


def _styling_story(output: Path, capture: Path) -> tuple[Section, ...]:
    paintings = tuple(
        Figure(capture / "styles" / f"{style}.png", f"for the {name}")
        for name, style in STYLES.items()
    )
    return (
        Section(
            "3. Objects to choose from",
            "stylesplat objects draws this sheet; stylesplat select gives an object a name.",
            (Figure(output / "scene" / "objects.png", "objects.png"),),
        ),
        Section(
            "4. Two styles",
            "The vase and the teapot each take on a painting, made by the package too. Only the "
            "colours of their Gaussians change.",
            paintings,
        ),
        Section(
            "5. All around",
            "The splat is in styled.ply and opens in any viewer.",
            (Figure(output / "orbit.mp4", "orbit.mp4"),),
        ),
    )


def _numbers(trained: dict[str, Any], styled: dict[str, Any], seconds: float) -> dict[str, str]:
    rows = {
        "Gaussians": f"{trained['gaussians']:,}",
        "held-out PSNR": f"{trained['psnr']:.2f} dB",
        "held-out SSIM": f"{trained['ssim']:.3f}",
        "training": f"{trained['steps']:,} steps in {trained['seconds']:.0f} s",
        "stylisation": f"{styled['seconds']:.0f} s",
        "changed Gaussians": f"{styled['changed_gaussians']:,}",
        "the whole demo": f"{seconds:.0f} s",
    }
    for name in STYLES:
        before, after = styled["nnfm_before"][name], styled["nnfm_after"][name]
        rows[f"style distance (NNFM), {name}"] = f"{before:.3f} before, {after:.3f} after"
    return rows
