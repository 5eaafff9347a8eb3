"""The gallery's commands in their order, with its names, boxes and clicks, on balls.

Of scenes that differ in names, boxes and the options of training only the first is made.

`sfm`, which needs the photos and minutes, and the tracing of the sign are not run: a capture of
balls lies where they put theirs, with the named photo and one ball in its box. Options for few
steps follow the page's words. tests/demo compares the names of the demo's paintings.
"""

import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

from balls import CAMERAS, COUNT, PLAIN, SPLATS, box_around, dense_ball, enlarged
from capture_files import write_ball_capture
from doc_pages import blocks
from still_life.nerfstudio import write_transforms
from stylesplat.cli import main
from stylesplat.io.label_maps import write_label_map
from stylesplat.io.scene_folder import open as open_scene
from stylesplat.io.splats.splat_files import write_splats
from stylesplat.masks import working_splat
from stylesplat.rendering.render import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.selection.labels import render_labels
from stylesplat.training.config import TrainConfig
from stylesplat.training.state import State

QUICKLY = {
    "train": "--steps 60 --max-gaussians 600 --downscale 8 --device cpu",
    "stylize": "--quality draft --steps 2 --overwrite",
}
VERBS = "sfm", "mask", "import", "select"
NAME = re.compile(r"--(?:box|name|style) (\w+)")
BOX = re.compile(r"--box \w+=([^:]+):(\S+)")
PREVIEW = 16  # times smaller than the named photo: what the balls are rendered at
OTHERS = 4  # times smaller than the named photo: the others, as large ones take long to read


def _paintings() -> dict[tuple[str, ...], list[str]]:
    """How each scene is painted, by the commands that make it."""
    found: dict[tuple[str, ...], list[str]] = {}
    for block in blocks("sh"):
        if block.page == "docs/gallery.md":
            *made_by, painted = block.text.splitlines()
            found.setdefault(tuple(made_by), []).append(painted)
    return {made_by: each for made_by, each in found.items() if "demo" not in made_by[0]}


def _kind(made_by: tuple[str, ...]) -> tuple[str, ...]:
    """The verbs and their options, but for those of training."""
    words = " ".join(each for each in made_by if " train " not in each).split()
    return tuple(each for each in words if each.startswith("--") or each in VERBS)


PAINTINGS = _paintings()
FIRST_OF_KIND = {_kind(made_by): made_by for made_by in reversed(PAINTINGS)}.values()


def capture_of_balls(folder: Path, name: str, edges: list[int]) -> None:
    """Photos of the balls; the one of this name is large, and shows one ball in a box."""
    size = torch.tensor([-(-side * 9 // 8 // PREVIEW) * PREVIEW for side in edges[2:]])
    Ks, sizes = CAMERAS.Ks.clone(), (size // OTHERS).repeat(len(CAMERAS), 1)
    Ks[:, :2] *= int(sizes[0, 0]) / int(CAMERAS.sizes[0, 0])
    sizes[0] = size
    left, upper, right, lower = box_around(render_labels(SPLATS, CAMERAS[0]) == 3, 1)
    times = min((edges[2] - edges[0]) / (right - left), (edges[3] - edges[1]) / (lower - upper))
    K = CAMERAS.Ks[0].clone()
    K[:2] *= times
    K[0, 2] += (edges[0] + edges[2] - times * (left + right)) / 2
    K[1, 2] += (edges[1] + edges[3] - times * (upper + lower)) / 2
    Ks[0] = K
    names = (name, *(f"other_{row}.jpg" for row in range(1, len(CAMERAS))))
    cameras = replace(CAMERAS, Ks=Ks, sizes=sizes, names=names)
    (folder / "images").mkdir(parents=True)
    for row, camera in enumerate(cameras):
        preview = camera.downscale(PREVIEW if row == 0 else PREVIEW // OTHERS)
        image = rasterize(SPLATS, preview)[0][0].clamp(0, 1)
        small = Image.fromarray((255 * image).round().to(torch.uint8).numpy())
        photo = small.resize(camera.size, Image.Resampling.BILINEAR)
        photo.save(folder / "images" / camera.names[0])
    write_transforms(cameras, folder, points=SPLATS.means)


def stand_in(made_by: tuple[str, ...]) -> None:
    """What the first command needs, or what it would make where it is not run."""
    words = made_by[0].split()
    if words[1] == "import":
        ball = torch.arange(len(PLAIN) + COUNT) >= len(PLAIN)
        colors = 0.2 + 0.6 * torch.rand(COUNT, 3, generator=torch.Generator().manual_seed(0))
        splats = dense_ball(colors)[ball]
        write_splats(replace(splats, identities=None, classifier=None), words[2])
    elif box := BOX.search(made_by[1]):
        capture_of_balls(Path(words[-1]), box[1], [int(edge) for edge in box[2].split(",")])
    else:  # the object's masks, in the capture or beside it
        folder = Path(words[words.index("-o" if "-o" in words else "--folder") + 1])
        masks = Path(words[-1]) if "--masks" in words else folder / "object_mask"
        cameras = enlarged(CAMERAS, 4)
        write_ball_capture(folder, cameras, masks=False)
        for camera in cameras:
            labels = (render_labels(SPLATS, camera) == 3).int()
            write_label_map(labels, masks / f"{Path(camera.names[0]).stem}.png")


@pytest.fixture
def quick_working_splat(monkeypatch: pytest.MonkeyPatch) -> None:
    real: Callable[..., State] = working_splat.fit

    def short(capture: Capture, config: TrainConfig, **options: Any) -> State:
        return real(capture, replace(config, steps=60), **options)

    monkeypatch.setattr(working_splat, "fit", short)
    monkeypatch.setattr("stylesplat.masks.from_boxes.DRAWN_BOX_SIZE", 160)
    monkeypatch.setattr("stylesplat.scene.virtual_cameras.VIRTUAL_VIEWS", 12)


@pytest.mark.usefixtures("quick_painting", "quick_working_splat")
@pytest.mark.parametrize("made_by", FIRST_OF_KIND, ids=lambda each: each[0].split()[-1])
def test_its_commands_lead_to_the_painting(
    made_by: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    stand_in(made_by)
    for style in re.findall(r"=(\w+\.jpg)", " ".join(PAINTINGS[made_by])):
        Image.effect_noise((64, 48), 60).convert("RGB").save(style)
    for command in (*made_by, *PAINTINGS[made_by]):
        _, verb, *words = shlex.split(command)
        if verb not in ("sfm", "benchmarks/traced_objects.py"):
            options = QUICKLY.get(verb, "").split()
            assert main([verb, *words, *options]) == 0, capsys.readouterr().err
    (layer,) = open_scene("painted").layers
    assert layer.name == PAINTINGS[made_by][-1].split("--style ")[1].split("=")[0]


def test_every_scene_of_the_gallery_is_here():
    assert len(PAINTINGS) == 8 and sum(map(len, PAINTINGS.values())) == 14
    assert len(FIRST_OF_KIND) == 5


@pytest.mark.parametrize("made_by", PAINTINGS, ids=lambda each: each[0].split()[-1])
def test_what_is_painted_is_what_was_named(made_by: tuple[str, ...]):
    named = {*NAME.findall(" ".join(made_by))} or {"1"}  # masks without names have ids
    assert {*NAME.findall(" ".join(PAINTINGS[made_by]))} == named
