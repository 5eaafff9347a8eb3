"""`evaluate A B --compare`: one page, one JSON, scenes that stay as they are."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

import stylesplat as ss
from balls import SPLATS
from processes import complaint, result, run


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
    assert one["metrics"] == result(capsys, "evaluate", scene, "--capture", capture, "-o", "x.json")
    assert other["differences"]["psnr"] == other["metrics"]["psnr"] - one["metrics"]["psnr"]
    text = page.read_text()
    assert text.count("data:image/jpeg;base64,") == 2 * len(found["views"]) == 2
    assert "darker &amp; others" in text and "://" not in text
    assert "$" not in re.sub(r"base64,[^\"]*", "", text), "every placeholder is filled"
    psnr = other["metrics"]["psnr"], other["differences"]["psnr"]
    assert f"<td>{psnr[0]:.4g} ({psnr[1]:+.3g})</td>" in text
    assert (scene / "metrics.json").read_bytes() == before


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_it_is_said_in_words(capture: Path, scene: Path, darker: Path, capsys):
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


def test_without_photos_there_are_pictures(scene: Path, darker: Path, capsys):
    found = result(capsys, "evaluate", scene, darker, "--compare", "-o", "p.html")
    assert [each["metrics"] for each in found["scenes"]] == [{}, {}] and len(found["notes"]) == 2
