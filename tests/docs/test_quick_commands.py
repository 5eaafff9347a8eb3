"""Commands of the pages that take a moment, run on three balls that stand for the pages' scenes.

Names, views and pixels are those of the pages. Left out, and why: EXCEPT.
"""

import shlex
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from PIL import Image

from balls import BLUE, CAMERAS, GREEN, RED, SPLATS, enlarged
from doc_pages import OURS, Command
from scenes import layer_towards
from stylesplat.cli import main
from stylesplat.io.scene_folder import save
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.projection import project
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import sh0_from_rgb

VERBS = {"select", "rename", "delete", "adjust", "recolor", "objects", "export"}
EXCEPT = {
    "--text": "needs a model",
    "--mesh": "needs photos from all sides, and seconds; tests/meshes",
    ".html": "seconds; tests/figures/test_web_page.py",
    "view_007": "of a scene without photos; tests/verbs/test_mask_scene.py",
    "view_000": "of splats of others, which are not here; tests/verbs/test_select.py",
    "--rows": "of a file of another program; tests/cli/test_objects.py",
    ".usd": "needs the extra usd; tests/io/splats",
    "NAME": "a placeholder",
    "640,700": "names a place on the table, which is no object here",
    " desk": "follows the line above it, which makes that name",
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
    cameras = enlarged(CAMERAS, 20)  # 960x720
    names = ("IMG_0007.jpg", "IMG_0031.jpg", *CAMERAS.names[2:])
    middle = project(SPLATS.means[RED].mean(dim=0, keepdim=True), cameras[0])[0][0]
    Ks = cameras.Ks.clone()
    Ks[0, :2, 2] += torch.tensor([640.0, 420.0]) - middle  # where the pages click
    cameras = replace(cameras, Ks=Ks, names=names)
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
    for name in ("wave.jpg", "night.jpg"):
        Image.new("RGB", (64, 48), (20, 60, 160)).save(folder / name)
    assert main(["recolor", str(folder / "garden-wave"), "--object", "vase", "--hue", "9"]) == 0
    return folder


@pytest.fixture
def reader(template: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    shutil.copytree(template, tmp_path / "reader")
    monkeypatch.chdir(tmp_path / "reader")
    yield tmp_path / "reader"


@pytest.mark.parametrize("command", QUICK, ids=lambda each: each.place)
def test_it_does_what_the_page_says(
    command: Command, reader: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command.words[1:]) == 0, capsys.readouterr().err
