"""`evaluate` of styled scenes: the numbers of `stylize` again, as far as they can be told."""

import json
import shutil
from pathlib import Path

import pytest
from PIL import Image

from balls import CAMERAS, SPLATS
from stylesplat.cli import main
from stylesplat.io.files import read_json, write_json
from stylesplat.io.scene_folder import Scene, write_scene
from stylesplat.stylization.features import weights

PER_RUN = ("seconds", "steps", "precision", "train")
NEEDS_STYLE = {"nnfm_before", "nnfm_after", "statistics_before", "statistics_after"}
NEEDS_NONE = {"content_ssim", "short_range_rmse", "outside_psnr", "changed_gaussians"}


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two balls with the colours of a gradient, and two views held out: consistency takes two."""
    folder = tmp_path_factory.mktemp("once")
    info = {"test_views": [*CAMERAS.names[:2]], "settings": {"downscale": 1.0}}
    write_scene(Scene(SPLATS, CAMERAS, info=info, metrics={"psnr": 30.0}), folder / "scene")
    Image.linear_gradient("L").resize((64, 64)).convert("RGB").save(folder / "style.png")
    styles = [text for id in (3, 7) for text in ("--style", f"{id}={folder / 'style.png'}")]
    options = ("--features", "compact", "--steps", "2", "--device", "cpu")
    arguments = (str(folder / "scene"), "-o", str(folder / "styled"))
    assert main(["stylize", *arguments, *styles, *options]) == 0
    return folder / "styled"


@pytest.fixture
def styled(once: Path, tmp_path: Path) -> Path:
    """A copy of it, with a style picture of its own."""
    out = shutil.copytree(once, tmp_path / "styled")
    picture = shutil.copy(once.with_name("style.png"), tmp_path / "style.png")
    recipe = read_json(out / "recipe.json")
    objects = [how | {"style": str(picture)} for how in recipe["objects"]]
    write_json(recipe | {"objects": objects}, out / "recipe.json")
    return out


@pytest.fixture
def evaluate(capture: Path, capsys: pytest.CaptureFixture[str]):
    """Evaluate a scene; the numbers, and the last line on stderr."""

    def evaluate(scene: Path) -> tuple[dict, str]:
        capsys.readouterr()
        options = ("--capture", str(capture), "--device", "cpu", "--json")
        assert main(["evaluate", str(scene), *options]) == 0
        captured = capsys.readouterr()
        numbers = json.loads(captured.out)
        assert read_json(scene / "metrics.json")["evaluate"] == numbers
        said = [line for line in captured.err.splitlines() if "not compared" in line]
        return numbers, "\n".join(said)

    return evaluate


def test_a_styled_scene_gets_the_numbers_of_stylize(styled: Path, evaluate):
    metrics = read_json(styled / "metrics.json")
    numbers, said = evaluate(styled)
    assert not said
    measured = {name: value for name, value in metrics.items() if name not in PER_RUN}
    assert NEEDS_STYLE | NEEDS_NONE <= set(measured)
    for name, value in measured.items():
        assert numbers[name] == pytest.approx(value, rel=1e-4), name
    assert numbers["psnr"] > 0 and numbers["iou"]
    assert {"train", *metrics} <= set(read_json(styled / "metrics.json"))


def test_numbers_follow_the_intensity(styled: Path, evaluate):
    full, _ = evaluate(styled)
    assert main(["adjust", str(styled), "--intensity", "0"]) == 0
    none, said = evaluate(styled)
    assert not said
    assert none["nnfm_before"] == full["nnfm_before"]
    assert none["nnfm_after"]["3"] != full["nnfm_after"]["3"]
    assert none["content_ssim"]["3"] > full["content_ssim"]["3"]


def test_a_plain_scene_has_no_such_numbers(scene: Path, evaluate):
    numbers, said = evaluate(scene)
    assert not said and not (NEEDS_STYLE | NEEDS_NONE) & set(numbers)


def test_a_lost_or_changed_picture_costs_only_its_numbers(styled: Path, tmp_path: Path, evaluate):
    style = tmp_path / "style.png"
    whole, _ = evaluate(styled)
    for spoil, expected in (
        (lambda: style.write_bytes(b"other"), "its digest differs"),
        (style.unlink, "there is no picture"),
    ):
        spoil()
        numbers, said = evaluate(styled)
        assert expected in said and len(said.splitlines()) == 1
        assert not NEEDS_STYLE & set(numbers)
        assert numbers == {name: v for name, v in whole.items() if name not in NEEDS_STYLE}


@pytest.mark.parametrize("file", [None, "lost.pth"])
def test_nothing_is_downloaded(
    file: str | None, styled: Path, evaluate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr(weights, "fetch_tensors", lambda *_, **__: pytest.fail("a download"))
    recipe = read_json(styled / "recipe.json")
    write_json(recipe | {"features": "vgg16", "weights": file}, styled / "recipe.json")
    numbers, said = evaluate(styled)
    assert (file or "vgg16") in said
    assert set(numbers) >= NEEDS_NONE and not NEEDS_STYLE & set(numbers)
