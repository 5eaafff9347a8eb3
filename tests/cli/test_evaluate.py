"""The verb `evaluate`: of a scene whose photos may have moved, of a styled one, of several."""

import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

import stylesplat as ss
from balls import CAMERAS, SPLATS
from capture_files import write_ball_capture
from processes import complaint, result, run
from stylesplat.io.captures.capture_folder import CAPTURE_EXACT
from stylesplat.io.json_yaml import read_json, write_json
from stylesplat.io.scene_folder import revise
from stylesplat.stylization import features as weights

PER_RUN = {"seconds", "seconds_by_object", "steps", "precision", "train"}
NEEDS_STYLE = {"nnfm_before", "nnfm_after"}
NEEDS_NONE = {"content_ssim", "outside_psnr", "changed_gaussians"}


def test_evaluate_compares_with_the_capture(capture: Path, scene: Path, capsys):
    metrics = result(capsys, "evaluate", scene, "--capture", capture)
    assert metrics["psnr"] > 30  # all but the losses of JPEG
    assert metrics["iou"] == {"3": 1, "7": 1, "300": 1}
    assert ss.open(scene).metrics == {"psnr": 30.0, "evaluate": metrics}
    exact = shutil.copytree(capture, scene.with_name("exact"))  # exact label maps are preferred
    (exact / "object_mask").rename(exact / CAPTURE_EXACT)
    other = ("--capture", exact)
    assert result(capsys, "evaluate", scene, *other)["iou"] == metrics["iou"]
    wrong = shutil.copytree(exact / CAPTURE_EXACT, exact / "object_mask")
    for file in wrong.glob("*.png"):
        Image.new("L", (48, 36)).save(file)
    assert result(capsys, "evaluate", scene, *other)["iou"] == metrics["iou"]
    assert result(capsys, "evaluate", scene, *other, "--masks", wrong)["iou"] != metrics["iou"]


def test_a_styled_scene_gets_the_numbers_of_stylize(
    styled: Path, capture: Path, tmp_path: Path, quick_painting: None, capsys
):
    before = read_json(styled / "metrics.json")
    capsys.readouterr()
    numbers = result(capsys, "evaluate", styled, "--capture", capture, "--device", "cpu")
    assert {*before} - PER_RUN | NEEDS_STYLE | NEEDS_NONE <= {*numbers}
    assert numbers["psnr"] > 0 and numbers["iou"]
    kept = before | {"evaluate": numbers}
    assert read_json(styled / "metrics.json") == kept
    file = tmp_path / "numbers.json"
    found = result(capsys, "evaluate", styled, "-o", file, "--device", "cpu")
    assert read_json(file) == found and NEEDS_NONE <= found.keys()
    assert read_json(styled / "metrics.json") == kept, "a file of its own has them"
    assert "--overwrite" in complaint(capsys, "evaluate", styled, "-o", file)


def test_numbers_without_bounds_are_none(scene: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setattr("stylesplat.load", lambda *_, **__: None)
    measured = {"psnr": math.inf, "by": {"vase": math.nan}}
    monkeypatch.setattr("stylesplat.evaluate", lambda *_, **__: measured)
    written = {"psnr": None, "by": {"vase": None}}
    assert result(capsys, "evaluate", scene, "--capture", scene.parent) == written
    assert ss.open(scene).metrics["evaluate"] == written


@pytest.mark.parametrize("file", [None, "lost.pth"])
def test_nothing_is_downloaded(
    file: str | None, styled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr(weights, "fetch_tensors", lambda *_, **__: pytest.fail("a download"))
    stack = read_json(styled / "layers.json")
    for how in stack["layers"]:
        how |= {"features": "vgg16", "weights": file and {"path": file, "sha256": None}}
    write_json(stack, styled / "layers.json")
    capsys.readouterr()
    assert run("evaluate", styled, "-o", tmp_path / "a.json", "--device", "cpu") == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "not compared" in line]
    assert len(said) == 2 and all((file or "vgg16") in line for line in said)
    numbers = read_json(tmp_path / "a.json")
    assert {*numbers} >= NEEDS_NONE and not NEEDS_STYLE & {*numbers}


@pytest.fixture
def darker(scene: Path) -> Path:
    folder = scene.with_name("darker & others")
    ss.save(replace(ss.open(scene), base=replace(SPLATS, sh0=SPLATS.sh0 - 0.5)), folder)
    return folder


def test_one_page_and_one_schema(capture: Path, scene: Path, darker: Path, tmp_path: Path, capsys):
    page, before = tmp_path / "page.html", (scene / "metrics.json").read_bytes()
    compare = ("evaluate", scene, darker, "--compare", "-o", page, "--capture", capture)
    found = result(capsys, *compare)
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
    assert "page.html exists" in complaint(capsys, *compare)
    assert run(*compare, "--overwrite") == 0
    *_, second, last = capsys.readouterr().err.strip().splitlines()
    assert re.fullmatch(
        r"darker & others: PSNR .* \(-.*\), SSIM .*, IoU .* % of .* differ\.", second
    )
    assert last == f"Page: {page}, with all numbers and 1 views of each."


def test_wrong_mixes_are_refused(scene: Path, darker: Path, capsys):
    for arguments, line in (
        ((scene, darker), "Cannot evaluate 2 scenes at once. Compare them"),
        ((scene, "--compare", "-o", "p.html"), "--compare needs at least two scenes, got one."),
        ((scene, darker, "--compare"), "--compare makes an HTML page, got none as its place."),
        ((scene, darker, "--compare", "-o", "p.json"), "got p.json as its place."),
    ):
        assert line in complaint(capsys, "evaluate", *arguments)
    page = ("--compare", "-o", scene.parent / "p.html")  # without photos it has pictures
    found = result(capsys, "evaluate", scene, darker, *page)
    assert [each["metrics"] for each in found["scenes"]] == [{}, {}] and len(found["notes"]) == 2


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with a capture and a scene of it, two of whose views are held out."""
    capture = write_ball_capture(tmp_path / "project/capture")
    scene = ss.Scene(SPLATS, CAMERAS, held_out=CAMERAS.names[:2], capture=capture)
    ss.save(scene, tmp_path / "project/scenes/balls")
    return tmp_path / "project"


def test_both_are_moved_together(project: Path, capsys: pytest.CaptureFixture[str]):
    before = ss.open(project / "scenes/balls")
    revise(before, replace(before, info={"more": 1}), project / "scenes/balls")
    moved = project.rename(project.with_name("elsewhere"))
    scene = ss.open(moved / "scenes/balls")
    assert scene.capture == moved / "capture" and scene.info == {"more": 1}
    assert result(capsys, "evaluate", moved / "scenes/balls")["psnr"] > 30
    ss.save(scene, moved / "copy")
    assert read_json(moved / "copy/scene.json")["capture"] == str(moved / "capture")
    assert read_json(moved / "copy/scene.json")["capture_relative"] == "../capture"


def test_photos_that_are_gone_are_asked_for(project: Path, tmp_path: Path, capsys):
    gone = project / "capture"
    moved = gone.rename(tmp_path / "garden")
    line = complaint(capsys, "evaluate", project / "scenes/balls")
    assert f"no longer in {gone}" in line and "--capture" in line
    numbers = result(capsys, "evaluate", project / "scenes/balls", "--capture", moved)
    assert numbers["psnr"] > 30


def test_held_out_photos_may_be_missing(project: Path, capsys: pytest.CaptureFixture[str]):
    scene, photos = project / "scenes/balls", project / "capture/images"
    whole = result(capsys, "evaluate", scene)
    (photos / CAMERAS.names[0]).unlink()
    assert result(capsys, "evaluate", scene)["psnr"] != whole["psnr"]
    (photos / CAMERAS.names[1]).unlink()
    assert "None of the 2 held-out photos" in complaint(capsys, "evaluate", scene)
