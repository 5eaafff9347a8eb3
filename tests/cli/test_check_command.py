"""`stylesplat check`: what it prints and draws, and what it refuses."""

from pathlib import Path

import pytest
from PIL import Image

from capture_files import write_ball_capture, write_cut_outs
from processes import complaint, result, run


@pytest.fixture
def posed(tmp_path: Path) -> Path:
    return write_ball_capture(tmp_path / "balls", masks=False)


def test_a_line_for_each_finding(posed: Path, capsys: pytest.CaptureFixture[str]):
    before = sorted(posed.parent.rglob("*"))
    assert run("check", posed) == 0
    lines = capsys.readouterr().err.splitlines()
    rows = {tuple(line.split(maxsplit=2)) for line in lines}
    few = "8 photos. They are too few for most scenes: take 40 to 100."
    assert ("photos", "poor", few) in rows
    assert ("sides", "good", "seen from all sides, every 45 degrees or closer.") in rows
    (one,), (other,) = ([s for s in lines if s.startswith(w)] for w in ("photos", "heights"))
    assert one.index("poor") == other.index("fair"), "columns are aligned"
    assert sorted(posed.parent.rglob("*")) == before, "nothing is written"


def test_the_next_step_of_cut_outs_is_no_mask(
    posed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert run("check", posed) == 0
    assert "Next: stylesplat mask " in capsys.readouterr().err
    assert run("check", write_cut_outs(tmp_path / "cut-outs")) == 0
    assert "Next: stylesplat train " in capsys.readouterr().err


def test_the_picture(posed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    picture = tmp_path / "check.jpg"
    shown = result(capsys, "check", posed, "-o", picture)
    assert shown["picture"] == str(picture) and shown["blurred"] == []
    assert shown["findings"]["photos"]["number"] == 8
    with Image.open(picture) as image:
        assert image.width > 1000
    written = picture.read_bytes()
    assert "--overwrite" in complaint(capsys, "check", posed, "-o", picture)
    assert picture.read_bytes() == written
    assert run("check", posed, "-o", picture, "--overwrite") == 0
    assert ".png" in complaint(capsys, "check", posed, "-o", tmp_path / "check.txt")
    (posed / "images" / "0003.jpg").unlink()
    assert run("check", posed) == 0
    assert "Missing, so left out: 0003.jpg" in capsys.readouterr().err
