"""The verb `export`."""

import json
from pathlib import Path

import pytest
import torch

from balls import SPLATS
from command_line import complaint, run
from stylesplat.io.splats.splat_ply import read_splat_ply


def test_export_keeps_every_bit(scene: Path, tmp_path: Path):
    assert run("export", scene, tmp_path / "out.ply") == 0
    exported = read_splat_ply(tmp_path / "out.ply")
    assert torch.equal(exported.means, SPLATS.means)
    assert torch.equal(exported.sh0, SPLATS.sh0)
    assert run("export", scene, tmp_path / "out.ply") == 1, "never overwrites by itself"
    assert run("export", scene, tmp_path / "out.ply", "--overwrite") == 0
    assert run("export", scene, tmp_path / "out.splat") == 0


def test_export_makes_a_page(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert run("export", scene, tmp_path / "out.html") == 0
    said = capsys.readouterr().err
    assert "out.html: 440 Gaussians, 0.0 MB. Any browser opens it, without a network." in said
    assert "exists" in complaint(capsys, "export", scene, tmp_path / "out.html")
    assert run("export", scene, tmp_path / "out.html", "--overwrite", "--sh-degree", 0) == 0
    with pytest.raises(SystemExit):
        run("export", "--help")
    assert ".html" in capsys.readouterr().out


def test_export_cuts_objects_out(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert run("export", scene, tmp_path / "red.ply", "--object", 3, "--object", 7, "--json") == 0
    count = json.loads(capsys.readouterr().out)["gaussians"]
    assert 0 < count < len(SPLATS) and len(read_splat_ply(tmp_path / "red.ply")) == count
    assert run("export", scene, tmp_path / "others.ply", "--without", 3, "--without", 7) == 0
    assert len(read_splat_ply(tmp_path / "others.ply")) == len(SPLATS) - count
    capsys.readouterr()
    assert run("export", scene, "--each", tmp_path / "parts") == 0
    assert "parts: 3.ply, 7.ply" in capsys.readouterr().err
    assert "Name one file" in complaint(capsys, "export", scene)
    both = ("--each", tmp_path / "more", "--object", 3)
    assert "--each writes every object" in complaint(capsys, "export", scene, *both)
