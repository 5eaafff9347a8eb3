"""The scripts of examples/, on three balls: each does what its first line says."""

from pathlib import Path

import pytest
import torch
from PIL import Image

import existing_splat
import many_paintings
import observer
import own_trainer
import photos_to_painting
import stylesplat as ss
from balls import CAMERAS, PLAIN, SPLATS, box_around, save_scene
from capture_files import write_ball_capture
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.selection.labels import render_labels
from stylesplat.stylization.config import StyleConfig

DOUBLE = CAMERAS.downscale(1 / 2)
pytestmark = pytest.mark.usefixtures("quick_painting")


@pytest.fixture
def picture(tmp_path: Path) -> str:
    stripes = torch.arange(64)[:, None].expand(64, 64) // 8 % 2 * 200
    Image.fromarray(stripes.to(torch.uint8).numpy()).convert("RGB").save(tmp_path / "wave.png")
    return str(tmp_path / "wave.png")


def test_from_photos_to_a_painting(picture: str, tmp_path: Path):
    photos = write_ball_capture(tmp_path / "photos", DOUBLE, masks=False)
    edges = box_around(render_labels(SPLATS, DOUBLE[0]) == 3, 4)
    box = f"{CAMERAS.names[0]}:{','.join(map(str, edges))}"
    out = tmp_path / "out"
    photos_to_painting.main(str(photos), box, picture, str(out), steps=100)
    before, painted = ss.open(out / "scene"), ss.open(out / "painted")
    assert [*before.objects] == ["object"] and [layer.name for layer in painted.layers] == [
        "object"
    ]
    assert (out / "painted.html").stat().st_size > 10_000


def test_a_splat_that_exists(picture: str, tmp_path: Path):
    write_splats(PLAIN, tmp_path / "garden.ply")
    ball, out = "-0.7,0,0.3,0.4", tmp_path / "painted.ply"
    existing_splat.main(str(tmp_path / "garden.ply"), ball, picture, str(out), up="z")
    painted = read_splats(out)
    before = painted.sh0[: len(PLAIN)] == PLAIN.sh0
    changed = ~before.flatten(1).all(dim=1)
    near = (PLAIN.means - torch.tensor([-0.7, 0, 0.3])).norm(dim=1) < 0.4
    assert changed.any() and not (changed & ~near).any(), "nothing else changes"


def test_many_paintings(picture: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    scene = save_scene(tmp_path / "scene")
    many_paintings.main("3", str(tmp_path / "out"), [str(scene)], [picture], steps=2)
    assert capsys.readouterr().out.startswith("scene-stylize: ")
    assert ss.open(tmp_path / "out" / "results" / "scene-stylize").layers[0].name == "3"


class Impatient(observer.Progress):
    """Cancels after some steps, and keeps what it is to draw."""

    def __init__(self, steps: int):
        super().__init__()
        self.steps, self.drawn = steps, list[str]()

    def draw(self, text: str) -> None:
        self.drawn.append(text)
        if "%" in text and text.startswith("3:"):
            self.steps -= 1
        if self.steps <= 0:
            self.cancel.set()


@pytest.mark.parametrize(("steps", "is_saved"), [(2, False), (10**6, True)])
def test_an_observer_shows_and_cancels(steps: int, is_saved: bool, picture: str, tmp_path: Path):
    scene, progress = save_scene(tmp_path / "scene"), Impatient(steps)
    before = {path.name: path.read_bytes() for path in scene.iterdir() if path.is_file()}
    observer.main(str(scene), "3", picture, str(tmp_path / "out"), progress)
    assert (tmp_path / "out").exists() == is_saved
    assert any(line.startswith("Cancelled while") for line in progress.drawn) != is_saved
    assert before == {path.name: path.read_bytes() for path in scene.iterdir() if path.is_file()}
    assert progress.what == "" or not is_saved, "what has ended shows no more"


def test_a_trainer_of_ones_own(picture: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    photos = write_ball_capture(tmp_path / "photos", CAMERAS)
    config = StyleConfig(quality="draft", steps=4)
    painted = own_trainer.main(str(photos), picture, steps=60, config=config)
    assert float(capsys.readouterr().out.split(" off")[0]) < 0.05
    assert len(painted) >= len(SPLATS)
