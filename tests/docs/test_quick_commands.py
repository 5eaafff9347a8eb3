"""Commands of the pages that take a moment, run on three balls that stand for the pages' scenes.

Names, views and pixels are those of the pages. Left out, and why: NOT_RUN and EXCEPT.
"""

import shlex
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from balls import BLUE, CAMERAS, GREEN, RED, SPLATS, enlarged
from doc_pages import OURS, Command
from scenes import layer_towards
from stylesplat.cli import main
from stylesplat.io.scene_folder import save
from stylesplat.io.splats.splat_files import write_splats
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import sh0_from_rgb

VERBS = {
    *("select", "rename", "delete", "adjust", "recolor", "objects", "export"),
    *("import", "render", "evaluate"),
}
NOT_RUN = {  # verbs, and why; the parser takes their commands (test_commands.py)
    "sfm": "minutes, of photos; tests/structure_from_motion",
    "check": "of photos with poses; tests/structure_from_motion",
    "mask": "minutes, of photos; test_gallery_commands.py, tests/masks, tests/verbs",
    "labels": "of photos; tests/verbs",
    "train": "minutes, of photos; test_gallery_commands.py, tests/training",
    "stylize": "minutes; test_gallery_commands.py and tests/demo run the gallery's, few steps",
    "sheet": "paints; tests/verbs",
    "batch": "runs other verbs; tests/batch_jobs",
    "demo": "minutes; tests/demo",
    "doctor": "a minute; tests/demo",
    "view": "serves until it is ended; tests/studio_app",
    "studio": "serves until it is ended; tests/studio_app",
    "mcp": "serves until it is ended; tests/cli",
}
EXCEPT = {
    "--text": "needs a model",
    "--mesh": "needs photos from all sides, and seconds; tests/meshes",
    ".html": "seconds; tests/figures/test_web_page.py",
    "view_007": "of a scene without photos; tests/verbs/test_mask_scene.py",
    "view_000": "of the gallery; test_gallery_commands.py",
    "--rows": "of a file of another program; tests/cli/test_objects.py",
    ".usd": "needs the extra usd; tests/io/splats",
    "640,700": "names a place on the table, which is no object here",
    " desk": "follows the line above it, which makes that name",
    "garden.ply garden": "of photos; tests/verbs/test_import.py",
    "nerfstudio_models": "of a file of another program; tests/io/splats",
    "ckpts/": "of a file of another program; tests/io/splats",
    "biker": "of the gallery; test_gallery_commands.py",
    "broche": "of the gallery; test_gallery_commands.py",
    "garden.spz --labels": "follows the line above it, which makes that file; tests/cli",
    "--seconds": "hundreds of pictures; tests/verbs/test_render.py",
    "fern": "of photos; tests/verbs",
    "--swap": "of colours that plain balls do not have; tests/verbs/test_recolor.py",
}
SCENES = ("scene", "garden-scene", "fox-scene")
PAINTED = ("painted", "styled", "garden-wave", "garden-styled", "demo/styled")


def is_run(words: list[str]) -> bool:
    line = shlex.join(words)
    return words[1] in VERBS and not any(each in line for each in EXCEPT)


QUICK = list({shlex.join(each.words): each for each in OURS if is_run(each.words)}.values())


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which a reader of the pages sits."""
    folder = tmp_path_factory.mktemp("reader")
    large, cameras = enlarged(CAMERAS[:1], 20), enlarged(CAMERAS, 4)  # 960x720, 192x144
    names = ("IMG_0007.jpg", "IMG_0031.jpg", *CAMERAS.names[2:])
    middle = project(SPLATS.means[RED].mean(dim=0, keepdim=True), large)[0][0]
    Ks, sizes = cameras.Ks.clone(), cameras.sizes.clone()
    Ks[0], sizes[0] = large.Ks[0], large.sizes[0]
    Ks[0, :2, 2] += torch.tensor([640.0, 420.0]) - middle  # where the pages click
    cameras = replace(cameras, Ks=Ks, sizes=sizes, names=names)
    table = ~(RED | GREEN | BLUE)
    masks = {"vase": RED, "pot": GREEN, "lid": BLUE, "lamp": BLUE.clone(), "table": table}
    objects = {name: SceneObject(mask) for name, mask in masks.items()}
    scene = Scene(SPLATS, cameras, held_out=names[:1], objects=objects, metrics={"psnr": 30.0})
    blue = replace(SPLATS, sh0=sh0_from_rgb(torch.full((len(SPLATS), 1, 3), 0.3)))
    layers = [layer_towards(SPLATS, blue, masks[name], name) for name in ("vase", "pot")]
    for name in SCENES:
        save(scene, folder / name)
    for name in PAINTED:
        (folder / name).parent.mkdir(exist_ok=True)
        save(scene.with_layers(layers), folder / name)
    save(scene.with_layers(layers[:1]), folder / "other")
    save(scene.with_layers(layers[:1]), folder / "garden-night")
    write_splats(SPLATS, folder / "garden.ply")
    write_splats(SPLATS, folder / "edited.ply")
    np.save(folder / "garden-labels.npy", RED.int().numpy())
    (folder / "flight.json").write_text(
        '{"seconds": 0.1, "keyframes": [{"view": "IMG_0007.jpg"}, {"view": "IMG_0031.jpg"}]}'
    )
    for name in ("wave.jpg", "night.jpg"):
        Image.new("RGB", (64, 48), (20, 60, 160)).save(folder / name)
    assert main(["recolor", str(folder / "garden-wave"), "--object", "vase", "--hue", "9"]) == 0
    return folder


@pytest.fixture
def reader(template: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    shutil.copytree(template, tmp_path / "reader")
    monkeypatch.chdir(tmp_path / "reader")
    monkeypatch.setattr("stylesplat.verbs.render.FRAMES", 3)
    yield tmp_path / "reader"


@pytest.mark.parametrize("command", QUICK, ids=lambda each: each.place)
def test_it_does_what_the_page_says(
    command: Command, reader: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = command.words[1:]
    made = reader / (words[words.index("-o") + 1] if "-o" in words else words[-1])
    if made.is_dir() and "-o" in words:
        shutil.rmtree(made)  # another command's input
    elif made.is_file():
        made.unlink()
    assert main(words) == 0, capsys.readouterr().err


def test_every_verb_is_run_or_named_with_the_reason():
    assert {each.words[1] for each in OURS} <= VERBS | NOT_RUN.keys()
    assert not VERBS & NOT_RUN.keys()
    lines = [shlex.join(each.words) for each in OURS if each.words[1] in VERBS]
    assert [what for what in EXCEPT if not any(what in line for line in lines)] == []
