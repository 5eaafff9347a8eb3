"""The verb `evaluate`: of styled scenes the numbers of `stylize` again, of several a page."""

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

import stylesplat as ss
from balls import CAMERAS, SPLATS
from processes import QUICK, complaint, result, run
from stylesplat.io.json_files import read_json, write_json
from stylesplat.stylization.features import weights

PER_RUN = ("seconds", "seconds_by_object", "steps", "precision", "train")
NEEDS_STYLE = {"nnfm_before", "nnfm_after"}
NEEDS_NONE = {"content_ssim", "short_range_rmse", "outside_psnr", "changed_gaussians"}


@pytest.fixture(scope="module")
def quickly(quick_painting: None) -> Iterator[None]:
    """Objects are compared with their styles at a size that has room for a way."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stylesplat.evaluation.style.LENGTH", 72.0)
        yield


@pytest.fixture(scope="module")
def once(quickly: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two balls with the colours of a gradient, and two views held out: consistency takes two."""
    folder = tmp_path_factory.mktemp("once")
    ss.save(
        ss.Scene(SPLATS, CAMERAS, held_out=CAMERAS.names[:2], metrics={"psnr": 30.0}),
        folder / "scene",
    )
    styles = []
    for id in ("3", "7"):
        Image.linear_gradient("L").resize((64, 64)).convert("RGB").save(folder / f"{id}.png")
        styles += ["--style", f"{id}={folder / f'{id}.png'}"]
    stylize = ("stylize", folder / "scene", "-o", folder / "styled", "--steps", 2)
    assert run(*stylize, *styles, *QUICK) == 0
    return folder / "styled"


@pytest.fixture
def styled(once: Path, tmp_path: Path) -> Path:
    return shutil.copytree(once, tmp_path / "styled")


@pytest.fixture
def evaluate(capture: Path, capsys: pytest.CaptureFixture[str]):
    """Evaluate a scene; the numbers, and what is said of objects that cannot be compared."""

    def evaluate(scene: Path) -> tuple[dict, list[str]]:
        capsys.readouterr()
        assert run("evaluate", scene, "--capture", capture, "--device", "cpu", "--json") == 0
        captured = capsys.readouterr()
        numbers = json.loads(captured.out)
        assert read_json(scene / "metrics.json")["evaluate"] == numbers
        return numbers, [line for line in captured.err.splitlines() if "not compared" in line]

    return evaluate


def test_evaluate_compares_with_the_capture(capture: Path, scene: Path, capsys):
    metrics = result(capsys, "evaluate", scene, "--capture", capture)
    assert metrics["psnr"] > 30  # all but the losses of JPEG
    assert metrics["iou"] == {"3": 1, "7": 1, "300": 1}
    assert ss.open(scene).metrics == {"psnr": 30.0, "evaluate": metrics}
    other = capture / "object_mask"
    assert result(capsys, "evaluate", scene, "--capture", capture, "--masks", other) == metrics


def test_a_styled_scene_gets_the_numbers_of_stylize(styled: Path, evaluate):
    metrics = read_json(styled / "metrics.json")
    numbers, said = evaluate(styled)
    assert not said
    measured = {name: value for name, value in metrics.items() if name not in PER_RUN}
    assert {"nnfm_before", "nnfm_after", "outside_psnr", "changed_gaussians"} <= set(measured)
    assert NEEDS_STYLE | NEEDS_NONE | set(measured) <= set(numbers)
    for name, value in measured.items():
        assert numbers[name] == pytest.approx(value, rel=0.01), name
    assert numbers["psnr"] > 0 and numbers["iou"]
    assert {"train", *metrics} <= set(read_json(styled / "metrics.json"))


@pytest.mark.parametrize("file", [None, "lost.pth"])
def test_nothing_is_downloaded(
    file: str | None, styled: Path, evaluate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr(weights, "fetch_tensors", lambda *_, **__: pytest.fail("a download"))
    stack = read_json(styled / "layers.json")
    for how in stack["layers"]:
        how |= {"features": "vgg16", "weights": file and {"path": file, "sha256": None}}
    write_json(stack, styled / "layers.json")
    numbers, said = evaluate(styled)
    assert len(said) == 2 and all((file or "vgg16") in line for line in said)
    assert set(numbers) >= NEEDS_NONE and not NEEDS_STYLE & set(numbers)


def test_numbers_in_a_file_of_their_own(
    styled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    before = (styled / "metrics.json").read_bytes()
    numbers = tmp_path / "numbers.json"
    found = result(capsys, "evaluate", styled, "-o", numbers, "--device", "cpu")
    assert read_json(numbers) == found and NEEDS_NONE <= found.keys()
    assert (styled / "metrics.json").read_bytes() == before
    assert "--overwrite" in complaint(capsys, "evaluate", styled, "-o", numbers)


@pytest.fixture
def darker(scene: Path) -> Path:
    folder = scene.with_name("darker & others")
    ss.save(replace(ss.open(scene), splats=replace(SPLATS, sh0=SPLATS.sh0 - 0.5)), folder)
    return folder


def test_one_page_and_one_schema(capture: Path, scene: Path, darker: Path, tmp_path: Path, capsys):
    page, before = tmp_path / "page.html", (scene / "metrics.json").read_bytes()
    found = result(capsys, "evaluate", scene, darker, "--compare", "-o", page, "--capture", capture)
    assert found["schema"] == "stylesplat-comparison-1" and found["page"] == str(page)
    one, other = found["scenes"]
    assert [one["name"], other["name"]] == ["scene", "darker & others"]
    assert one["metrics"] == result(
        capsys, "evaluate", scene, "--capture", capture, "-o", tmp_path / "x.json"
    )
    assert other["differences"]["psnr"] == other["metrics"]["psnr"] - one["metrics"]["psnr"]
    text = page.read_text()
    assert text.count("data:image/jpeg;base64,") == 2 * len(found["views"]) == 2
    assert "darker &amp; others" in text and "://" not in text
    assert "$" not in re.sub(r"base64,[^\"]*", "", text), "every placeholder is filled"
    psnr = other["metrics"]["psnr"], other["differences"]["psnr"]
    assert f"<td>{psnr[0]:.4g} ({psnr[1]:+.3g})</td>" in text
    assert (scene / "metrics.json").read_bytes() == before


def test_it_is_said_in_words(
    capture: Path, scene: Path, darker: Path, tmp_path: Path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    call = ("evaluate", "--compare", scene, darker, "-o", "p.html", "--capture", capture)
    assert run(*call) == 0
    *_, second, last = capsys.readouterr().err.strip().splitlines()
    assert re.fullmatch(
        r"darker & others: PSNR .* \(-.*\), SSIM .*, IoU .* % of its pixels differ\.", second
    )
    assert last == "Page: p.html, with all numbers and 1 views of each."
    assert "p.html exists" in complaint(capsys, *call)


def test_wrong_mixes_are_refused(scene: Path, darker: Path, capsys):
    for arguments, line in (
        ((scene, darker), "Cannot evaluate 2 scenes at once. Compare them"),
        ((scene, "--compare", "-o", "p.html"), "--compare needs at least two scenes, got one."),
        ((scene, darker, "--compare"), "--compare makes an HTML page, got none as its place."),
        ((scene, darker, "--compare", "-o", "p.json"), "got p.json as its place."),
    ):
        assert line in complaint(capsys, "evaluate", *arguments)


def test_without_photos_there_are_pictures(scene: Path, darker: Path, tmp_path: Path, capsys):
    page = ("-o", tmp_path / "p.html")
    found = result(capsys, "evaluate", scene, darker, "--compare", *page)
    assert [each["metrics"] for each in found["scenes"]] == [{}, {}] and len(found["notes"]) == 2
